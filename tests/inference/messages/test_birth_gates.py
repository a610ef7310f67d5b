"""What may bear surfaces is told in one place, by which all systems on paths go."""

import pytest
from scene_samples import shortened

import gridslam as gs
from gridslam.inference.messages import birth_gates
from gridslam.inference.messages.births import Births, with_births

SYSTEMS = [gs.GridSlam, gs.AdaptiveSlam, gs.NetworkSlam, gs.NetworkGridSlam]


@pytest.mark.parametrize("gate", ["leave_sights", "without_double_bounces"])
@pytest.mark.parametrize("system", SYSTEMS)
def test_what_a_gate_shuts_out_is_born_in_no_system(system, gate, monkeypatch):
    scene = shortened(gs.Scene.load("room"), 4).with_filter(particles=256)
    plain, shut, asked = system(scene, seed=3), system(scene, seed=3), []

    def closed(births, state, scan, cloud_or_paths, ratios, *more, **work):
        asked.append(len(births))
        nothing = Births.none()
        return (nothing, with_births(ratios, nothing)) if gate == "leave_sights" else nothing

    for scan in gs.simulate(scene, "agent1", seed=2):
        plain.step(scan)
        with monkeypatch.context() as patch:
            patch.setattr(birth_gates, gate, closed)
            estimate = shut.step(scan)
    assert len(plain.state.surfaces)
    assert any(asked)
    assert not len(shut.state.surfaces)
    assert not len(estimate.surfaces)


def test_every_gate_is_told_which_anchors_may_bear_surfaces(monkeypatch):
    told = []

    def proposed(*given, work):
        told.append(given[-1])
        return "births", "ratios"

    def apart(births, *given, work):
        told.append(given[-1])
        return births

    monkeypatch.setattr(birth_gates, "propose_births", proposed)
    monkeypatch.setattr(
        birth_gates, "leave_sights", lambda births, state, scan, paths, ratios, radio: (births, ratios)
    )
    monkeypatch.setattr(birth_gates, "without_double_bounces", apart)
    found = birth_gates.admitted_births(*[None] * 7, "senders", work=None)
    assert found == ("births", "ratios")
    assert told == ["senders", "senders"]
