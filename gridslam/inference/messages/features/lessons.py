"""Learning beside the filter: what a segment teaches takes effect at a fixed step after its end.

Meanwhile the filter goes on with what it knows, in a thread of its own. Then it is given what was learned and
goes through the steps since once more. A step is a function of the state alone: the state holds the segment
that is being learned from, and whoever has only the state (after a checkpoint) learns from it when it is due.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

from gridslam import runtime
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.following import START_STEPS, FeatureWork, leapt
from gridslam.inference.messages.features.learning import Learned, learn, with_new_segment
from gridslam.inference.messages.features.rivals import replay
from gridslam.inference.messages.features.settling import settle
from gridslam.inference.state.features.hybrid_state import HybridState
from gridslam.inference.workspace.workspace import timed
from gridslam.world.signal_model import SignalModel

LEARN_EVERY = 30
"""Steps of a segment."""
BESIDE = 5
"""Steps after which what was learned takes effect."""
SETTLED = START_STEPS + BESIDE
"""Steps after which there are no particles any more."""
Taught = tuple[HybridState, Learned]


class Beside:
    """A thread that learns ahead of when it is due; results don't depend on it."""

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._asked: tuple[HybridState, Future[Taught]] | None = None

    def begin(self, lesson: HybridState, front: Front, model: SignalModel) -> None:
        """Start to learn from a state."""
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, "learning")
        self._asked = lesson, self._pool.submit(teach, lesson, front, model)

    def result(self, lesson: HybridState, front: Front, model: SignalModel) -> Taught:
        """What a state teaches, waited for or found now."""
        asked, self._asked = self._asked, None
        if asked is not None and asked[0] is lesson:
            return asked[1].result()
        return teach(lesson, front, model)


class HybridWork(FeatureWork):
    """What steps of hybrid SLAM share, with what learns beside them.

    Attributes
    ----------
    beside : Beside
        Learns ahead of when it is due.
    """

    def __init__(self, front: Front, seed: int) -> None:
        super().__init__(front, seed)
        self.beside = Beside()


def teach(lesson: HybridState, front: Front, model: SignalModel) -> Taught:
    """The state with what its segment teaches: the joint belief in place of particles, or new features."""
    with runtime.one_blas_thread():
        if lesson.particles is not None:
            return settle(lesson, front, model), Learned()
        return learn(lesson, front, model)


@timed("learn")
def apply_lesson(state: HybridState, model: SignalModel, *, work: HybridWork) -> tuple[HybridState, Learned]:
    """The state with what the lesson teaches, (M132), (M137), once that is due."""
    lesson = state.lesson
    if lesson is None or state.step < lesson.step + BESIDE:
        return state, Learned()
    after, learned = work.beside.result(lesson, work.front, model)
    state = replace(state, lesson=None)
    if lesson.particles is None and after.joint is lesson.joint:  # nothing was taken
        return state, learned
    since = state.segment.last(state.step - lesson.step)
    joint, evidence, track = replay(after.joint, since, lesson.time_s, lesson.step, model, led=False)
    since = replace(since, agent=track, evidence=evidence)
    if state.particles is None:
        state = leapt(state, state.joint, joint, since=0)
    collected = after.segment  # of particles the segment goes on, else it began anew
    return replace(
        state, joint=joint, before=after.before, before_s=after.before_s, segment=collected.joined(since),
        particles=None, next_identity=after.next_identity,
    ), learned  # fmt: skip


@timed("learn")
def begin_lesson(state: HybridState, model: SignalModel, *, work: HybridWork) -> HybridState:
    """The state with a lesson, where a segment has ended, and a new segment begun."""
    first = state.step == START_STEPS and state.particles is not None
    if not first and (state.step % LEARN_EVERY or state.particles is not None):
        return state
    work.beside.begin(state, work.front, model)
    return replace(state if first else with_new_segment(state, state.joint), lesson=state)


def due(state: HybridState) -> bool:
    """Whether a state that holds a lesson can be one: the lesson ended less than `BESIDE` steps ago."""
    lesson = state.lesson
    if lesson is None:
        return True
    ends = lesson.step == START_STEPS if lesson.particles is not None else not lesson.step % LEARN_EVERY
    in_time = 0 <= state.step - lesson.step < BESIDE
    return ends and in_time and lesson.lesson is None
