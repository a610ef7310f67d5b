"""Tables of several agents: files lose nothing, rows reach whose they are, and every fault is one line."""

import numpy as np
import pytest
from scipy.io import savemat
from tables import same, table

from gridslam.errors import InputError
from gridslam.measurements.network import NetworkMeasurements
from gridslam.measurements.table import Measurements
from gridslam.world.clocks import ClockTruth
from gridslam.world.trajectory import Trajectory

ANCHORS = ("A", "B")
HEADER = "step,time_s,agent,anchor,distance_m"


def network(**changes):
    rows = table(
        step=[0, 0, 2, 3],
        time_s=[0.0, 0.0, 1.0, 1.5],
        anchor=[-1, 1, 0, -1],
        distance_m=[-7.5, 3.0, 2.0, 1.0],
    )
    measurements = Measurements(**rows, unlabelled=True, pseudo=True, steps=5, interval_s=0.5)
    return NetworkMeasurements(("me", "you"), measurements, np.array([0, 1, 0, 1]), **changes)


def test_a_step_hands_every_agent_its_own_rows():
    measurements = network()
    scan = measurements.scan(0)
    np.testing.assert_array_equal(scan.scans[0].distance_m, [-7.5])
    np.testing.assert_array_equal(scan.scans[1].anchor, [1])
    assert [len(one) for one in measurements.scan(2).scans] == [
        1,
        0,
    ]  # who is silent between two rows is there
    assert measurements.scan(3).scans[0] is None  # and whose last row is past has left
    np.testing.assert_array_equal(measurements["you"].step, [0, 3])
    assert measurements["me"].steps == 3


def test_presence_outlasts_silence():
    scan = network(present=[[0, 4], [0, 3]]).scan(4)
    assert len(scan.scans[0]) == 0
    assert scan.scans[1] is None
    with pytest.raises(InputError, match="'me' from step 1"):
        network(present=[[1, 4], [0, 3]])
    with pytest.raises(InputError, match="aren't whole"):
        network(present=[[0, np.nan], [0, 3]])


@pytest.mark.parametrize("kind", ["csv", "h5"])
def test_files_keep_everything(tmp_path, kind):
    track = Trajectory([0.0, 0.5], [[1, 2], [3, 4]], [[0, 1], [1, 0]], [0.1, 0.2])
    clocks = ClockTruth(("A", "B", "me", "you"), [0.0, 0.5], np.arange(8).reshape(2, 4) * 1e-9)
    measurements = network(present=[[0, 4], [0, 3]], tracks={"you": track}, clocks=clocks)
    path = tmp_path / f"heard.{kind}"
    (measurements.to_csv if kind == "csv" else measurements.to_h5)(path)
    read = NetworkMeasurements.load(path, ANCHORS, ["me", "you", "nobody"], pseudo=True)
    assert read.agents == ("me", "you")
    np.testing.assert_array_equal(read.agent, measurements.agent)
    same(read.table, measurements.table)
    if kind == "h5":
        np.testing.assert_array_equal(read.present, measurements.present)
        assert read.tracks == {"you": track}
        np.testing.assert_array_equal(read.clocks.metres(("you",)), clocks.metres(("you",)))
        assert len(read) == 5


def test_anchor_may_be_left_out_and_agent_where_there_is_one(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("step,time_s,distance_m\n0,0,1.5\n1,1,2.5\n")
    measurements = NetworkMeasurements.from_csv(path, ANCHORS, ["me"])
    assert measurements.agents == ("me",)
    np.testing.assert_array_equal(measurements.table.anchor, [-1, -1])
    with pytest.raises(InputError, match=r"a.csv: line 1: found no column 'agent'"):
        NetworkMeasurements.from_csv(path, ANCHORS, ["me", "you"])


def test_without_a_column_agent_all_rows_are_those_of_the_one_that_was_asked_for(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# toolkit 4.1\n# site: flat\nstep,time_s,distance_m\n0,0,1.5\n1,1,2.5\n")
    measurements = NetworkMeasurements.load(path, ANCHORS, ["me", "you"], alone="you")
    assert measurements.agents == ("you",)
    with pytest.raises(
        InputError,
        match=r"a.csv: line 3: found no column 'agent'; allowed: one, where .* its name \(--agent\)",
    ):
        NetworkMeasurements.load(path, ANCHORS, ["me", "you"])


def test_a_table_of_one_agent_reads_as_a_network_and_back(tmp_path):
    Measurements(**table()).to_h5(tmp_path / "one.h5")
    measurements = NetworkMeasurements.from_h5(tmp_path / "one.h5")
    same(measurements[measurements.agents[0]], Measurements(**table()))
    network().of(["you"]).to_h5(tmp_path / "you.h5")
    np.testing.assert_array_equal(Measurements.from_h5(tmp_path / "you.h5").distance_m, [3.0, 1.0])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f"{HEADER}\n0,0,me,C,1", r"line 2: anchor: found 'C'; allowed: A, B"),
        (f"{HEADER}\n0,0,me,A,1\n0,0,he,,1", r"line 3: agent: found 'he'; allowed: me, you"),
        (f"{HEADER}\n0,0,,A,1", r"line 2: agent: found ''"),
        (
            f"{HEADER}\n0,0,me,A,-1",
            r"line 2: distance_m: found -1.0; allowed: a number above 0 \(any, in a scene with \[clocks\]\)",
        ),
        (f"{HEADER}\n0,0,me,A,1\n0,1,you,A,1", r"line 3: time_s: .*one time for all rows"),
    ],
)
def test_fault_of_a_table_is_one_line(tmp_path, text, says):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=says) as caught:
        NetworkMeasurements.from_csv(path, ANCHORS, ["me", "you"])
    assert "\n" not in str(caught.value)


def test_agents_that_repeat_or_heard_nothing_are_named():
    measurements = network()
    with pytest.raises(InputError, match="'me' twice"):
        NetworkMeasurements(("me", "me"), measurements.table, measurements.agent)
    with pytest.raises(InputError, match="'he', who heard nothing at all"):
        NetworkMeasurements(("me", "you", "he"), measurements.table, measurements.agent)
    with pytest.raises(InputError, match="'he'; allowed: me, you"):
        measurements.of(["he"])


def test_one_agents_reader_refuses_several(tmp_path):
    measurements = network()
    measurements.to_csv(tmp_path / "a.csv")
    measurements.to_h5(tmp_path / "a.h5")
    with pytest.raises(InputError, match="anchor"):
        Measurements.from_csv(tmp_path / "a.csv", ANCHORS, pseudo=True)
    (tmp_path / "b.csv").write_text(f"{HEADER}\n0,0,me,A,1\n0,0,you,A,2\n")
    with pytest.raises(InputError, match="2 agents"):
        Measurements.from_csv(tmp_path / "b.csv")
    with pytest.raises(InputError, match="2 agents"):
        Measurements.from_h5(tmp_path / "a.h5")


def mat(path, **changes):
    """The network's rows as MATLAB holds a table; anchors counted from 1, 0 where not known."""
    measurements = network()
    rows = {key: values[:, None] for key, values in measurements.table.columns.items()}
    rows |= {"anchor": measurements.table.anchor[:, None] + 1.0, "agent": measurements.agent[:, None] + 1.0}
    whole = {key: value for key, value in (rows | changes).items() if value is not None}
    savemat(path, {"measurements": whole})
    return path


def names(*words):
    return np.array([*words, None], dtype=object)[:-1].reshape(-1, 1)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"agent": names("me", "you", "me", "you"), "anchor": names("", "B", "A", "")},
        {"agent": np.array([[2.0], [1], [2], [1]]), "agents": names("you", "me")},
    ],
    ids=["numbers", "names", "own list"],
)
def test_matlab_files_of_several_agents_read_as_csv(tmp_path, changes):
    measurements = network()
    read = NetworkMeasurements.load(mat(tmp_path / "a.mat", **changes), ANCHORS, ["me", "you"], pseudo=True)
    assert read.agents == ("me", "you")
    np.testing.assert_array_equal(read.agent, measurements.agent)
    same(read.table, measurements.table)


@pytest.mark.parametrize(
    ("changes", "agents", "says"),
    [
        ({"agent": np.array([[1.0], [3], [1], [1]])}, ["me", "you"], r"agent: found 3; allowed: 1 to 2"),
        ({"agent": names("me", "he", "me", "me")}, ["me", "you"], r"agent: found 'he'; allowed: me, you"),
        ({"agent": None}, ["me", "you"], "no variable 'agent'"),
        ({"agent": np.ones((3, 1))}, ["me"], "agent: found 3 values; allowed: 4, as in step"),
        ({"anchor": names("", "Z", "A", "")}, ["me", "you"], r"anchor: found 'Z'; allowed: A, B"),
        (
            {"anchor": np.array([[-2.0], [1], [1], [1]])},
            ["me", "you"],
            "anchor: found -2.0; .*0 where it isn't",
        ),
    ],
)
def test_fault_of_a_matlab_file_of_several_agents_is_one_line(tmp_path, changes, agents, says):
    with pytest.raises(InputError, match=says) as caught:
        NetworkMeasurements.from_mat(mat(tmp_path / "a.mat", **changes), ANCHORS, agents, pseudo=True)
    assert "\n" not in str(caught.value)
    assert "a.mat" in str(caught.value)


def test_a_reader_of_one_agent_refuses_a_matlab_file_of_two(tmp_path):
    path = mat(tmp_path / "a.mat", anchor=np.ones((4, 1)), distance_m=np.ones((4, 1)))
    with pytest.raises(InputError, match="agent: found 2 agents"):
        Measurements.from_mat(path)
    alone = mat(tmp_path / "b.mat", anchor=np.ones((4, 1)), distance_m=np.ones((4, 1)), agent=np.ones((4, 1)))
    assert len(Measurements.from_mat(alone).step) == 4
