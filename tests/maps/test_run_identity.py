"""Maps say which runs they are made of: no evidence counts twice, whatever way it came."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from scene_samples import shortened

import gridslam as gs
from gridslam.maps.run_identity import Identity, alike_runs, parallel, same_run


@pytest.fixture(scope="module")
def scene():
    return shortened(gs.Scene.load("room"), 6, agents=2)


@pytest.fixture(scope="module")
def measurements(scene):
    return {seed: gs.simulate(scene, "agent1", seed=seed) for seed in (1, 2)}


def mapped(scene, measurements, **more):
    return gs.map_scene(scene, measurements, particles=300, **more).map


@pytest.fixture(scope="module")
def maps(scene, measurements):
    """Two runs apart from each other."""
    return [mapped(scene, measurements[seed]) for seed in (1, 2)]


def test_runs_that_may_have_heard_one_pass_are_told(maps):
    """Samples and the paths extracted from them have other checksums, of one agent, seed and steps."""
    one, other = (grid.provenance for grid in maps)
    assert one["kinds"] == ["paths"]
    both = {key: [*one[key], *other[key]] for key in one} | {"kinds": ["paths", "signal"]}
    (note,) = alike_runs(replace(maps[0], provenance=both))
    names = f"{one['runs'][0][:8]} and {other['runs'][0][:8]}"
    assert note.startswith(f"map: agent1's runs {names} heard samples and paths, at 6 steps each")
    apart = {"seeds": [0, 1], "steps": [6, 7], "agents": ["a", "b"], "kinds": ["paths"] * 2}
    for change in ({key: value} for key, value in (apart | {"kinds": ["paths", ""]}).items()):
        assert not alike_runs(replace(maps[0], provenance=both | change))
    assert not alike_runs(replace(maps[0], provenance=both | {"kinds": ["signal"]}))


@pytest.mark.slow
def test_identity_follows_from_what_was_heard(scene, measurements, maps):
    (one,), (other,) = (grid.provenance["runs"] for grid in maps)
    assert mapped(scene, measurements[1]).provenance["runs"] == [one]
    assert mapped(scene, measurements[1], seed=5).provenance["runs"] == [
        one
    ]  # the same evidence, filtered again
    assert mapped(scene, measurements[1], method="adaptive").provenance["runs"] == [one]
    assert not same_run(one, other)
    slam, at = gs.GridSlam(scene.with_filter(particles=300)), []
    for scan in measurements[1]:
        slam.step(scan)
        at += slam.map().provenance["runs"]
    assert at[-1] == one
    assert all(same_run(early, one) and not same_run(early, other) for early in at)


def test_what_was_not_measured_is_the_same_whatever_its_sign(scene, measurements, tmp_path):
    """A table made anew, as of a file or with a true track, wraps its angles: that turns NaN's sign."""
    without = replace(measurements[1], aod_rad=np.full(len(measurements[1].step), np.nan))
    without.to_h5(tmp_path / "heard.h5")
    again = gs.Measurements.from_h5(tmp_path / "heard.h5")
    start, bits = Identity.of(scene.anchor_positions), set()
    for table in (without, again, replace(without)):
        bits.add(np.signbit(table.aod_rad).all())
        assert [start.after(scan) for scan in table] == [start.after(scan) for scan in without]
    assert bits == {True, False}, "both signs"


def test_identity_outlives_a_checkpoint(scene, measurements, maps, tmp_path):
    slam = gs.GridSlam(scene.with_filter(particles=300))
    for number, scan in enumerate(measurements[1]):
        if number == 3:
            slam.save(tmp_path / "half.h5")
            slam = gs.GridSlam.resume(tmp_path / "half.h5")
        slam.step(scan)
    assert slam.map().provenance["runs"] == maps[0].provenance["runs"]


def test_evidence_never_counts_twice(scene, measurements, maps):
    one, other = maps
    whole = gs.fuse([one, other])
    seen = one.observed & other.observed
    np.testing.assert_allclose(whole.evidence[seen], (one.evidence + other.evidence)[seen], rtol=1e-5)
    later = mapped(scene, measurements[2], agent="agent2", prior_map=one)
    assert later.provenance["runs"] == one.provenance["runs"] + other.provenance["runs"]
    for pair in (
        [one, one],
        [one, later],
        [later, other],
        [whole, one],
        [one, mapped(scene, measurements[1], seed=3)],
    ):
        with pytest.raises(gs.InputError, match=r"agent[12]'s run"):
            gs.fuse(pair)


def test_what_a_map_was_made_of_is_not_heard_again(scene, measurements, maps):
    with pytest.raises(gs.InputError, match=r"map: found agent1's run .* they would count twice"):
        mapped(scene, measurements[1], seed=3, prior_map=maps[0])
    slam = gs.GridSlam(scene.with_filter(particles=300), prior_map=maps[0])
    with pytest.raises(gs.InputError, match="count twice"):
        slam.step(next(iter(measurements[1])))
    assert slam.state.step == 0
    slam.step(next(iter(measurements[2])))


def test_map_that_holds_a_run_twice_is_refused_and_says_so(say, scene, measurements, maps, tmp_path):
    """Earlier versions made such maps."""
    lists = {key: maps[0].provenance[key] * 2 for key in ("agents", "seeds", "steps", "runs")}
    twice = replace(maps[0], provenance={**maps[0].provenance, **lists})
    with pytest.raises(gs.InputError, match=r"map 1: found the evidence of agent1's run .* twice"):
        gs.fuse([twice, maps[1]])
    with pytest.raises(gs.InputError, match=r"the evidence of agent1's run .* twice"):
        mapped(scene, measurements[2], prior_map=twice)
    twice.save(tmp_path / "twice.h5")
    assert "twice: nobody goes on from it" in say("check", "twice.h5").out


def test_map_of_an_earlier_version_can_be_handed_over(scene, measurements, maps):
    kept = {key: value for key, value in maps[0].provenance.items() if key != "runs"}
    old = replace(maps[0], provenance=kept)
    runs = mapped(scene, measurements[2], agent="agent2", prior_map=old).provenance["runs"]
    assert runs == ["", *maps[1].provenance["runs"]]


@pytest.mark.slow
def test_fuse_on_the_command_line(say, maps, tmp_path):
    for name, grid in zip(("a.h5", "b.h5"), maps, strict=True):
        grid.save(tmp_path / name)
    result = say("fuse", "a.h5", "b.h5", "-o", "both.h5")
    assert (result.code, result.err) == (0, "")
    assert "wrote both.h5: map by agent1, agent1: 96 x 76 cells" in result.out
    both = gs.Map.load("both.h5")
    assert sorted(both.provenance["runs"]) == sorted(run for g in maps for run in g.provenance["runs"])
    before = Path("both.h5").read_bytes()
    for words, why in {
        ("a.h5", "b.h5", "-o", "both.h5"): "both.h5: found something of this name",
        ("a.h5", "a.h5", "-o", "c.h5"): "a.h5 and a.h5, both with the evidence of agent1's run",
        ("both.h5", "b.h5", "-o", "c.h5"): "both.h5 and b.h5, both with the evidence",
        ("a.h5", "-o", "c.h5"): "two or more maps",
        ("a.h5", "none.h5", "-o", "c.h5"): "none.h5",
        ("a.h5", "b.h5", "-o", "c.txt"): "ends in .h5",
    }.items():
        result = say("fuse", *words)
        assert result.code == 2
        assert len(result.complaints) == 1
        assert why in result.err
    assert Path("both.h5").read_bytes() == before
    assert not Path("c.h5").exists()
    assert say("fuse", "b.h5", "a.h5", "-o", "both.h5", "--overwrite").code == 0


@pytest.mark.slow
def test_map_of_another_building_is_refused(say, scene, maps, no_figures, tmp_path):
    data = scene.model_dump(exclude_none=True)
    data["anchors"] = [{**anchor, "name": f"flat {anchor['name']}"} for anchor in data["anchors"]]
    flat = gs.Scene.checked(data, "flat")
    (tmp_path / "flat.toml").write_text(flat.to_toml())
    maps[0].save(tmp_path / "room.h5")
    other = mapped(flat, gs.simulate(flat, "agent1", seed=9))
    other.save(tmp_path / "flat.h5")
    asked = "run", "flat.toml", "--agent", "agent1", "--particles", 300, "--map", "room.h5", "-o", "out"
    result = say(*asked)
    assert result.code == 2
    assert "room.h5: frame: found anchors A, B, none of those of room" in result.err
    assert "--same-frame" in result.err
    assert len(result.complaints) == 1
    assert not Path("out").exists()
    assert say(*asked, "--same-frame").code == 0
    fused = "fuse", "room.h5", "flat.h5", "-o", "both.h5"
    result = say(*fused)
    assert (result.code, len(result.complaints)) == (2, 1)
    assert "frame of flat.h5" in result.err
    assert say(*fused, "--same-frame").code == 0


def test_kinds_that_earlier_versions_did_not_say_are_blank():
    both = {"agents": ["a", "b"], "seeds": [0, 1], "steps": [6, 7], "runs": ["11", "22"]}
    assert parallel(both)["kinds"] == ["", ""]
    assert parallel(both | {"kinds": ["paths"]})["kinds"] == ["", ""]  # fused: of which of them isn't known
    assert parallel(both | {"kinds": ["paths", "signal"]})["kinds"] == ["paths", "signal"]


def test_a_filter_of_an_earlier_versions_checkpoint_makes_its_map(scene, measurements, tmp_path):
    slam = gs.GridSlam(scene.with_filter(particles=300))
    for scan in list(measurements[1])[:2]:
        slam.step(scan)
    slam.save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        known = json.loads(file["run"].attrs["provenance"])
        assert known.pop("kinds") == []
        file["run"].attrs["provenance"] = json.dumps(known)
    assert gs.GridSlam.resume(tmp_path / "a.h5").map().provenance["kinds"] == ["paths"]
