"""Whether a filter trusts itself: all that `Estimate.health.why` may say, and where it comes from.

Sentences stand in `reasons`. Numbers are those of docs/model.md.

===================  ===========================================  ===============================  ===========
reason               said when                                    by                               formula
===================  ===========================================  ===============================  ===========
`silent`             nothing was heard for 5 steps                all monitors                     section 9
`vague`              the position is known to 1 m or worse; an    all monitors                     section 9,
                     agent wasn't found since a silence                                            (M572)
`unchecked`          the position is known to 0.3 m or worse,     `monitor.HealthMonitor.assess`   section 9
                     and of late (some ten steps) fewer than 4
                     measurements were too loud for clutter
`blind`              the position was known to 0.5 m or worse     `monitor.HealthMonitor.assess`   (M533)
                     since the latest line of sight
`found_again`        pose recovery (direct grid SLAM: (M522))     `monitor.HealthMonitor.assess`   (M576)
                     moved the agent 0 to 4 steps ago
`found_again`        it began where first arrivals told, and      `systems.direct`                 (M535)
                     they haven't since, in 40 steps at most
                     (direct SLAM)
`leapt`              up to 99 steps ago it was moved to where no  `monitor.HealthMonitor.assess`   (M512)
                     motion may have led
`few_explained`      half as many loud measurements as usual are  `monitor.HealthMonitor.assess`   section 9
                     explained
`little_power`       known paths have less than a fifth of the    `signal_watch.SignalWatch`       section 9
                     power (direct SLAM)
`MIRRORED`           the position was too wide to tell the sides  `signal_watch.SignalWatch`       (M444)
                     of the anchors in sight, and no other has
                     been since (direct SLAM)
`misfit`             innovations leave their chi-square band      `monitor`, `signal_watch`        section 9
`clutter`            an anchor's clutter is over 3 times the      `monitor.HealthMonitor.assess`   (M46),
                     scene's, and over 0.75 a step; never by                                    (M579)
                     scans without amplitudes
`turned`             an anchor's turn is beyond doubt, and        `monitor.HealthMonitor.assess`,  section 9,
                     `offset` isn't told of all anchors           `sight_watch.SightWatch`         (M511)
`few_particles`      fewer than 3 (hybrid SLAM: 30) carry an      `monitor`,                       section 9,
                     association, where the belief is particles   `signal_watch.assess_particles`  section 15
`early`              at over half of the latest steps something   `signal_watch`                   (M451)
                     arrives before the line of sight (hybrid
                     SLAM)
`early`              at over a quarter of the latest steps a      `early_watch.arrives_early`      (M525)
                     loud path is shorter than the line of sight
                     to the one place believed in
`early`              the same of a network: a loud path can be    `early_watch.no_anchors`         (M532)
                     of no anchor
`UNSIGHTED`          lines of sight were heard at fewer than 10   `signal_watch.assess_particles`  section 15
                     steps and half of all, and one is believed,
                     or features were learned (hybrid SLAM)
`leapt`              up to 99 steps ago it was moved by over      `signal_watch.assess_particles`  (M529)
                     half a metre and five of its deviations
                     (hybrid SLAM)
`crowded`            over 30 loud paths of one anchor             `monitor.HealthMonitor.assess`   section 9
`left_out`           over 24 surfaces are in sight                `monitor`; of networks           (M575)
                                                                  `management.network.merging`
`NOT_FOUND`          a vague start is still searched for          `management.start_search`        (M202),
                                                                                                   (M91)
`several_places`     several hypotheses count                     `doubt.places`; direct SLAM:     section 14,
                                                                  `image_starts`                   (M91)
`fresh_start`        the lead over a start anew is below 4 nats   `doubt.Doubt.against`            (M206)
`elsewhere`          scans alone fit another place better         `doubt.Doubt.against`            (M253),
                                                                                                   (M471)
`elsewhere`          the same of paths in samples (direct grid    `doubt.Doubt.against`            (M522)
                     SLAM)
`elsewhere`          two lines of sight or more put an agent of   `fresh_look.FreshLook`           (M492)
                     a network elsewhere, three times
`UNPROVEN`           a start was taken from a list that lacks     `doubt.Doubt.tried`              (M392)
                     places, and nothing has borne it out
`TURNABLE`           a vague start with one anchor and no AoD     `management.hypotheses`          section 14
`TURNABLE`           antennas tell no directions, and fewer than  `signal_watch.assess_particles`  section 15
                     two anchors were in sight at 10 steps or
                     more, with features (hybrid SLAM)
`OFF_GRID`           the agent is outside the scene's region      `management.hypotheses`          section 14
`ASTRAY`             an agent of a network is lost, or was found  `systems.network`                section 13
                     again up to 4 steps ago
`CLOCK_OPEN`         an agent's clock is wide, and no anchor's    `systems.network`                (M496)
                     is set that it is tied to
`CLOCK_CONTESTED`    lines of sight stand for another clock of    `systems.network`                (M531)
                     an agent, not enough to set it there yet
`offset`             lines of sight don't cross: distances are    `range_watch.RangeWatch`         (M262),
                     off by the same                                                               (M537)
`height`             the same: anchors stand higher or lower      `range_watch.RangeWatch`         (M262)
`shifted`            the same: an anchor stands elsewhere         `range_watch.RangeWatch`         (M262)
`of_late`            any of these three is told of the latest     `range_watch.RangeWatch`         (M537)
                     looks alone
`offset`, `shifted`  an anchor's line of sight has been longer    `sight_watch.SightWatch`         (M510)
                     or shorter by the same of late (said with
                     `of_late`), where the place is known
===================  ===========================================  ===============================  ===========

`monitor` (measured paths) and `signal_watch` (samples) judge one state by how measurements fitted it. `doubt`
judges all hypotheses by evidence, which `management.challenge` compares. `range_watch` judges what no filter
can see, by where lines of sight cross (`crossings`); `sight_watch` what a filter can that knows its place, by
each line of sight alone. Where the agent moved as no motion does, anchors aren't accused.
"""
