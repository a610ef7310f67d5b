"""Whether a filter trusts itself: all that `Estimate.health.why` may say, and where it comes from.

Sentences stand in `reasons`. Numbers are those of docs/model.md.

==================  ==========================================  ===============================  ============
reason              said when                                   by                               formula
==================  ==========================================  ===============================  ============
`silent`            nothing was heard for 5 steps               all monitors                     section 9
`vague`             the position is known to 1 m or worse; an   all monitors                     section 9,
                    agent wasn't found since a silence                                           (M572)
`unchecked`         the position is known to 0.3 m or        `monitor.HealthMonitor.assess`   section 9
                    worse, and of late (some ten steps) fewer
                    than 4 measurements were too loud for
                    clutter
`blind`             the position was known to 0.5 m or worse `monitor.HealthMonitor.assess`   (M533)
                    since the latest line of sight
`found_again`       pose recovery (direct grid SLAM: (M522))    `monitor.HealthMonitor.assess`   section 9
                    moved the agent 0 to 4 steps ago
`found_again`       it began where first arrivals told, and    `systems.direct`                 (M535)
                    they haven't since, in 40 steps at most
                    (direct SLAM)
`leapt`             up to 99 steps ago it was moved to where  `monitor.HealthMonitor.assess`   (M512)
                    no motion may have led
`few_explained`     half as many loud measurements as usual     `monitor.HealthMonitor.assess`   section 9
                    are explained
`little_power`      known paths have less than a fifth of the   `signal_watch.SignalWatch`       section 9
                    power (direct SLAM)
`MIRRORED`          the position was too wide to tell the   `signal_watch.SignalWatch`       (M444)
                    sides of the anchors in sight, and no
                    other has been since (direct SLAM)
`misfit`            innovations leave their chi-square band     `monitor`, `signal_watch`        section 9
`clutter`           an anchor's clutter is 3 times the scene's  `monitor.HealthMonitor.assess`   (M46)
`turned`            an anchor's turn is beyond doubt, and       `monitor.HealthMonitor.assess`,  section 9,
                    `offset` isn't told of all anchors          `sight_watch.SightWatch`         (M511)
`few_particles`     fewer than 3 (hybrid SLAM: 30) carry an     `monitor`,                       section 9, 15
                    association, where the belief is particles  `signal_watch.assess_particles`
`early`             at over half of the latest steps        `signal_watch`                   (M451)
                    something arrives before the line of
                    sight (hybrid SLAM)
`early`             at over a quarter of the latest steps a     `early_watch.arrives_early`      (M525)
                    loud path is shorter than the line of
                    sight to the one place believed in
                    (of a network: can be of no anchor)      `early_watch.no_anchors`         (M532)
`UNSIGHTED`         lines of sight were heard at fewer than 10  `signal_watch.assess_particles`  section 15
                    steps and half of all, and one is believed,
                    or features were learned (hybrid SLAM)
`leapt`             up to 99 steps ago it was moved by over     `signal_watch.assess_particles`  (M529)
                    half a metre and five of its deviations
                    (hybrid SLAM)
`crowded`           over 30 loud paths of one anchor            `monitor.HealthMonitor.assess`   section 9
`left_out`          over 24 surfaces are in sight               `monitor`; of networks           section 9
                                                                `management.network.merging`
`NOT_FOUND`         a vague start is still searched for         `management.start_search`        (M202), (M91)
`several_places`    several hypotheses count                    `doubt.places`; direct SLAM      section 14,
                                                                `image_starts`                   (M91)
`fresh_start`       the lead over a start anew is below 4 nats  `doubt.Doubt.against`            (M206)
`elsewhere`         scans alone fit another place better        `doubt.Doubt.against`            (M253),
                                                                                 (M471)
                    (direct grid SLAM: paths in samples)        `doubt.Doubt.against`            (M522)
                    two lines of sight or more put an agent `fresh_look.FreshLook`           (M492)
                    of a network elsewhere, three times
`UNPROVEN`          a start was taken from a list that lacks    `doubt.Doubt.tried`              (M392)
                    places, and nothing has borne it out
`TURNABLE`          a vague start with one anchor and no AoD    `management.hypotheses`          section 14
`TURNABLE`          antennas tell no directions, and fewer than    `signal_watch.assess_particles`  section 15
                    two anchors were in sight at 10 steps or
                    more, with features (hybrid SLAM)
`OFF_GRID`          the agent is outside the scene's region     `management.hypotheses`          section 14
`ASTRAY`            an agent of a network is lost, or was       `systems.network`                section 13
                    found again up to 4 steps ago
`CLOCK_OPEN`        an agent's clock is wide, and no anchor's is    `systems.network`                (M496)
                    set that it is tied to
`CLOCK_CONTESTED`   lines of sight stand for another clock  `systems.network`                (M531)
                    of an agent, not enough to set it there yet
`offset`, `height`, lines of sight don't cross                  `range_watch.RangeWatch`         (M262),
`shifted`, `of_late`                                                                             (M537)
`offset`, `shifted` an anchor's line of sight has been longer   `sight_watch.SightWatch`         (M510)
`of_late`           or shorter by the same of late, where the
                    place is known
==================  ==========================================  ===============================  ============

`monitor` (measured paths) and `signal_watch` (samples) judge one state by how measurements fitted it. `doubt`
judges all hypotheses by evidence, which `management.challenge` compares. `range_watch` judges what no filter
can see, by where lines of sight cross (`crossings`); `sight_watch` what a filter can that knows its place, by
each line of sight alone. Where the agent moved as no motion does, anchors aren't accused.
"""
