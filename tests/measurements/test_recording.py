"""Recordings of sampled signals: nothing is lost in files, and every fault is named."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from signal_samples import FREQUENCIES, recording, sampled_scene, samples_of

import gridslam as gs
from gridslam.errors import InputError
from gridslam.io.hdf5_guard import seal

PAIR = {"rows": 1, "columns": 2, "spacing_wavelengths": 0.5}
FULL = {"radio": {"array": PAIR, "pulse": {"width_hz": 3e8, "rolloff": 0.3}}, "heading_sensor_deg": 1.0}


def test_hdf5_keeps_all_of_it(tmp_path):
    recording = gs.simulate(sampled_scene(**FULL), "me", 4, what="signal")
    recording.to_h5(tmp_path / "a.h5")
    read = gs.Recording.from_h5(tmp_path / "a.h5")
    for name in ("samples", "time_s", "heard", "heading_rad", "anchor_position_m", "anchor_orientation_rad"):
        assert np.array_equal(getattr(read, name), getattr(recording, name)), name
    assert (read.anchors, read.truth) == (recording.anchors, recording.truth)
    for name in ("offset_hz", "pulse", "anchor_element_m", "agent_element_m"):
        assert getattr(read.waveform, name) == pytest.approx(getattr(recording.waveform, name), rel=1e-12), (
            name
        )
    assert read.waveform.carrier_hz == recording.waveform.carrier_hz
    assert read.waveform.heading_std_rad == recording.waveform.heading_std_rad
    with h5py.File(tmp_path / "a.h5") as file:
        assert dict(file.attrs) == {"format": "gridslam-signal", "version": 1}
        assert file["signal/samples"].shape == (3, 1, 2, 2, 41, 2)
        assert file["signal/samples"].dtype == np.float32
        units = []
        file.visititems(
            lambda _, item: units.append("unit" in item.attrs) if isinstance(item, h5py.Dataset) else None
        )
        assert all(units)


def test_steps_are_handed_out_in_double_precision_with_what_is_missing_left_out():
    z = samples_of([5.0], 3).repeat(2, axis=1)
    z[1, 0] = np.nan
    received = np.array([[1, 1], [0, 1], [1, 1]], bool)
    scans = list(recording(z, anchors=["A", "B"], heard=received, time_s=[0.0, 0.5, 2.0]))
    assert [scan.time_s for scan in scans] == [0.0, 0.5, 2.0]
    assert [len(scan) for scan in scans] == [2, 1, 2]
    assert scans[1].samples.shape == (2, 1, 1, 41)
    assert scans[1].samples.dtype == np.complex128
    assert not scans[1].samples[0].any()
    assert scans[0].heading_rad is None


def test_one_antenna_needs_no_elements_and_the_carrier_takes_up_what_frequencies_are_off():
    one = recording(frequency_hz=FREQUENCIES + 2e8)
    assert one.waveform.carrier_hz == pytest.approx(6.2e9)
    assert one.waveform.offset_hz == pytest.approx(FREQUENCIES)
    assert one.waveform.agent_element_m.tolist() == [[0.0, 0.0]]


FAULTS = {
    "uneven": ({"frequency_hz": FREQUENCIES + np.eye(41)[3] * 100}, "frequency_hz.*evenly spaced"),
    "falling": ({"frequency_hz": FREQUENCIES[::-1]}, "frequency_hz.*rising"),
    "absolute": ({"frequency_hz": FREQUENCIES + 6e9}, "about the carrier"),
    "others": ({"frequency_hz": FREQUENCIES[:-1]}, r"frequency_hz.*\(40,\).*41"),
    "carrier": ({"carrier_hz": 1e8}, "carrier_hz"),
    "no anchors": ({"anchors": []}, "anchors.*none"),
    "anchors twice": ({"anchors": ["A", "A"]}, "anchors.*once"),
    "pulse": ({"pulse": np.zeros(41)}, "pulse"),
    "time": ({"time_s": [0.0, 0.0, 1.0]}, "time_s.*rising"),
    "noise": ({"noise_std": [0.0]}, "noise_std"),
    "heading": ({"heading_rad": [0.0, np.nan, 0.0]}, "heading_rad"),
    "heard": ({"heard": np.zeros((3, 1))}, "heard.*nothing"),
    "heard shape": ({"heard": np.ones((2, 1))}, "heard"),
    "position": ({"anchor_position_m": [[0.0, 0.0, 0.0]]}, "anchor_position_m"),
    "deviation": ({"heading_std_rad": -1.0}, "std_rad"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_told_in_one_line(fault):
    changes, says = FAULTS[fault]
    with pytest.raises(InputError, match=says) as refused:
        recording(**changes)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("value", "says"), [(np.nan, "NaN"), (np.inf, "NaN or inf"), (0.0, "zeros"), (1e300, "inf")]
)
def test_snapshots_that_cannot_be_are_refused_where_they_are(value, says):
    z = samples_of([5.0], 3)
    z[2] = value
    with pytest.raises(InputError, match=rf"samples\[2, 0\].*{says}.*heard = false"):
        recording(z)


def test_few_frequencies_and_odd_shapes_are_refused():
    with pytest.raises(InputError, match="at least 8"):
        recording(samples_of([5.0])[..., :7], frequency_hz=FREQUENCIES[:7])
    with pytest.raises(InputError, match="shape"):
        recording(np.ones((3, 41)))


def test_real_numbers_are_refused_in_memory_and_in_files(tmp_path):
    """Their phases are lost, and with them every length: magnitudes, or a real part, were kept."""
    told = "signal: samples: found real numbers alone; allowed: complex samples"
    z = samples_of([5.0], 3)
    for samples in (z.real, np.abs(z), np.abs(z) + 0j, np.ones((3, 1, 41), int)):
        with pytest.raises(InputError, match=told):
            recording(samples)
    recording(z).to_h5(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["signal/samples"][..., 1] = 0
    content = (tmp_path / "a.h5").read_bytes().split(b"gridslam crc32 ")[0]
    (tmp_path / "a.h5").write_bytes(content + seal(content))
    with pytest.raises(InputError, match=told):
        gs.Recording.from_h5(tmp_path / "a.h5")


def test_elements_must_be_given_and_in_metres():
    z = 1j * np.ones((3, 1, 2, 1, 41))
    with pytest.raises(InputError, match=r"anchor_element_m.*none of 2"):
        recording(z)
    spaced = np.array([[[0.0, 0.0], [0.0, 0.25]]])
    recording(z, anchor_element_m=0.05 * spaced)
    for factor in (1.0, 1e3 * 0.05):  # wavelengths, millimetres
        with pytest.raises(InputError, match=r"element_m.*wavelengths.*metres"):
            recording(z, anchor_element_m=factor * spaced)
    with pytest.raises(InputError, match="one place"):
        recording(z, anchor_element_m=0 * spaced)


def test_files_of_another_kind_cut_short_or_promising_too_much_are_refused(tmp_path):
    path = tmp_path / "a.h5"
    recording().to_h5(path)
    content = path.read_bytes()
    (tmp_path / "short.h5").write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match="cut short"):
        gs.Recording.from_h5(tmp_path / "short.h5")
    with pytest.raises(InputError, match=r"format.*gridslam-signal.*gridslam-measurements"):
        gs.Measurements.from_h5(path)
    with h5py.File(path, "r+") as file:
        del file["signal/samples"]
        promise = file["signal"].create_dataset("samples", (3, 1, 1000, 1000, 41, 2), "f4", chunks=True)
        promise.attrs["carrier_hz"] = 6e9
    content = path.read_bytes()
    path.write_bytes(content + seal(content))
    with pytest.raises(InputError, match="as many as the file holds"):
        gs.Recording.from_h5(path)


@pytest.mark.parametrize("name", ["signal/samples", "signal/frequency_hz", "anchors/name", "signal/time_s"])
def test_files_without_what_must_be_there_name_it(tmp_path, name):
    path = tmp_path / "a.h5"
    recording().to_h5(path)
    with h5py.File(path, "r+") as file:
        del file[name]
    content = path.read_bytes()
    path.write_bytes(content + seal(content))
    with pytest.raises(InputError, match=f"{name.split('/')[1]}.*no dataset"):
        gs.Recording.from_h5(path)


SCANS = {
    "shape": ({"samples": np.ones((1, 1, 41))}, "samples"),
    "NaN": ({"samples": np.full((1, 1, 1, 41), np.nan)}, "NaN"),
    "zeros": ({"samples": np.zeros((1, 1, 1, 41))}, "zeros"),
    "heard": ({"heard": np.ones(2, bool)}, "heard"),
    "time": ({"time_s": np.nan}, "time_s"),
    "back": ({"time_s": -1.0}, "later than -0.5"),
    "heading": ({"heading_rad": np.inf}, "heading"),
    "text": ({"samples": "none"}, "numbers"),
}


@pytest.mark.parametrize("fault", SCANS)
def test_scans_that_make_no_sense_are_refused(fault):
    changes, says = SCANS[fault]
    whole = {"step": 0, "time_s": 0.0, "samples": np.ones((1, 1, 1, 41)), "heard": np.ones(1, bool)}
    assert len(gs.SignalScan(**whole).checked(1)) == 1
    with pytest.raises(InputError, match=says):
        gs.SignalScan(**{**whole, **changes}).checked(1, after=-0.5)


def variables(**changes):
    z = samples_of([5.0, 9.0], 3, 0.01)
    return {
        "samples": z,
        "carrier_hz": np.array([[6e9]]),
        "frequency_hz": FREQUENCIES[:, None],
        "anchors": cell(["north"]),
        "time_s": np.array([[0.0, 0.5, 1.0]]),
        "anchor_position_m": np.array([[1.0, 2.0]]),
        **changes,
    }


def cell(words):
    found = np.empty((len(words), 1), object)
    found[:, 0] = words
    return found


def write_5(path, content, group):
    savemat(path, {group: content} if group else content)


def write_73(path, content, group):
    """As MATLAB writes version 7.3: arrays transposed, complex numbers as pairs, cells as references."""
    with h5py.File(path, "w", userblock_size=512) as file:
        place = file.create_group(group) if group else file
        for name, value in content.items():
            if value.dtype == object:
                codes = [np.array([[ord(c)] for c in word], np.uint16) for word in value.ravel()]
                texts = [file.create_dataset(f"#refs#/{name}{k}", data=code) for k, code in enumerate(codes)]
                links = np.array([[text.ref for text in texts]], h5py.ref_dtype)
                place.create_dataset(name, data=links, dtype=h5py.ref_dtype)
            elif value.dtype.kind == "c":
                pair = np.empty(value.T.shape, [("real", "f8"), ("imag", "f8")])
                pair["real"], pair["imag"] = value.T.real, value.T.imag
                place[name] = pair
            else:
                place[name] = value.T
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(512))


@pytest.mark.parametrize("group", [None, "signal"])
@pytest.mark.parametrize("write", [write_5, write_73])
def test_matlab_files_of_every_version_hold_the_same(tmp_path, write, group):
    path, content = tmp_path / "z.mat", variables()
    write(path, content, group)
    read = gs.Recording.load(path)
    assert (read.anchors, read.time_s.tolist()) == (("north",), [0.0, 0.5, 1.0])
    assert read.samples[:, 0, 0, 0] == pytest.approx(content["samples"][:, 0], rel=1e-6)
    assert read.waveform.offset_hz == pytest.approx(FREQUENCIES)
    assert read.anchor_position_m.tolist() == [[1.0, 2.0]]


def test_matlab_arrays_keep_their_axes_and_anchors_may_be_numbered(tmp_path):
    recording = gs.simulate(sampled_scene(**FULL), "me", 4, what="signal")
    form = recording.waveform
    elements = {"anchor_element_m": form.anchor_element_m, "agent_element_m": form.agent_element_m}
    content = variables(samples=recording.samples, pulse=form.pulse, **elements)
    del content["anchors"]
    write_5(tmp_path / "z.mat", content, None)
    read = gs.Recording.from_matlab(tmp_path / "z.mat")
    assert read.anchors == ("1",)
    assert np.array_equal(read.samples, recording.samples)
    assert read.waveform.agent_element_m == pytest.approx(form.agent_element_m)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"samples": cell(["x"])}, "samples.*numbers"),
        ({"carrier_hz": np.array([[6e9, 1.0]])}, "carrier_hz.*2 values"),
        ({"time_s": np.array([[0j, 1j, 2j]])}, "time_s.*complex"),
        ({"anchors": np.array([[1.0]])}, "anchors.*cell array"),
        ({"frequency_hz": FREQUENCIES[:7]}, r"z.mat.*frequency_hz.*\(41,\)"),
    ],
)
def test_matlab_faults_are_told_with_their_variable(tmp_path, changes, says):
    write_5(tmp_path / "z.mat", variables(**changes), None)
    with pytest.raises(InputError, match=says):
        gs.Recording.load(tmp_path / "z.mat")


def test_matlab_files_without_samples_or_cut_short_are_refused(tmp_path):
    content = variables()
    write_5(tmp_path / "z.mat", {"carrier_hz": content["carrier_hz"]}, None)
    with pytest.raises(InputError, match="no variable 'samples'"):
        gs.Recording.load(tmp_path / "z.mat")
    write_5(tmp_path / "z.mat", content, None)
    whole = (tmp_path / "z.mat").read_bytes()
    (tmp_path / "z.mat").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="damaged"):
        gs.Recording.load(tmp_path / "z.mat")


def test_headings_in_degrees_are_refused_before_they_are_wrapped():
    heading, told = (
        np.array([10.0, 50.0, 93.0]),
        r"heading_rad: found 93; allowed: radians, four turns at most",
    )
    samples, offset = 1j * np.ones((3, 1, 8), np.complex64), 1e7 * np.arange(8)
    with pytest.raises(InputError, match=told):
        gs.Recording.from_arrays(samples, 6e9, offset, ["A"], heading_rad=heading)
    assert len(gs.Recording.from_arrays(samples, 6e9, offset, ["A"], heading_rad=np.radians(heading))) == 3
