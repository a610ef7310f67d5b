"""Taichi kernels: arrays in, arrays out. They know nothing of scenes."""

import inspect

# Each decorator of Taichi's asks whose the frame is that imports the file: a frozen module's, which `inspect`
# looks for among all modules there are, a fifth of a second until the first step, unless it is told.
inspect.modulesbyfile["<frozen importlib._bootstrap>"] = "importlib._bootstrap"

CELL_SLABS = {"cpu": 4, "gpu": 64}
"""Fixed sets of paths that are cast side by side, by device."""

PATH_BLOCK = 32
"""Particles that the evaluation kernel takes at a time; kept here so that owners needn't start Taichi."""

ALREADY_LISTED = -2
"""Stands for an anchor where paths are given and none are to be listed."""

TAKE_ROOT, ROOT_GIVEN, STATE_GIVEN = 0, 1, 2
"""What is to be made ready to draw: root of the covariance and samples, samples alone, or nothing."""

UNMEASURED = 1e12
"""Variance that stands for "not measured"."""

FAINTEST = 0.3
"""Amplitude below which accuracy is taken to get no worse: nothing fainter is detected."""

REPLACES = 10
"""Detections from which on a surface may take a ghost's place."""

OFTENER = 2
"""How many times as often as a ghost each of the two was seen that take its place: it goes silent when they
are found."""

SEEN_ELSEWHERE = 0.3
"""Existence of another anchor's ray at which a surface isn't a ghost; below it for all, it is silent."""

LIKELIER_THAN_NOT = 0.5
"""Probability of having caused a measurement above which a path is held to have done so."""

LEAST_SENDING = 0.1
"""Probability of its ray and surfaces from which on a path sends to cells."""

USUAL_REFLECTION = 0.7
"""Coefficient of a known surface, where no better one is at hand."""

HEARD_BY_ANOTHER = 0.5
"""Chance that a line which one anchor hears is heard by another one, too."""

HEIGHT, GIVEN_HEIGHT, RISE = 3, 4, 5
"""Columns of anchors' places, after x, y and orientation: height above the agent as believed, and as told;
which rise makes it another."""

MISFIT, FREEDOM, GAIN, GAIN_PRECISION, CAUSED, LOUD_ONES, TURNED, TURNED_PRECISION, LEAST_PARTICLES = range(9)
SUMS = 9
"""What `fitting` sums up of an anchor, by column: misfit, degrees of freedom; gain times its precision, and
that; loud measurements that some path caused, and all of them; turn times its precision, and that; and the
least effective number of particles."""

DECIDED = 30.0
"""Log odds from which on a wall isn't looked at any more, and beyond which those of a point don't go."""
