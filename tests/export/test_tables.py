"""Tables of cameras and joints, read back by the score."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pzcap.export import formats
from pzcap.geometry.camera import of_track
from pzcap.scoring.command import main
from pzcap.scoring.files import read_results
from tests.scenes import exported


def test_the_score_reads_what_is_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    take = exported.take()
    files = formats.write(take, "csv", tmp_path)
    place = tmp_path / take.file
    assert {place / "results.json", place / "cameras.csv", place / "joints.csv"} <= set(files)
    found, whole = read_results(place), take.reconstruction
    assert found.camera_names == whole.camera_names
    assert found.timecodes == whole.timecodes
    assert found.body is not None
    assert whole.motion is not None
    valid = whole.motion.valid
    np.testing.assert_allclose(found.body.joints_m[valid], whole.motion.joints_m[valid])
    for number, (track, wanted) in enumerate(zip(found.cameras, whole.tracks, strict=True)):
        assert track is not None
        assert wanted is not None
        located = np.flatnonzero(wanted.valid)
        np.testing.assert_array_equal(np.flatnonzero(track.valid), located)
        np.testing.assert_allclose(track.focal_px[located], wanted.focal_px[located])
        assert track.poses is not None
        head = whole.cameras[number]
        assert head is not None
        stood = of_track(head, wanted, int(located[0])).world_T_cam
        np.testing.assert_allclose(track.poses.position_m[located[0]], stood[:3, 3], atol=1e-9)
        np.testing.assert_allclose(track.poses.rotation[located[0]], stood[:3, :3], atol=1e-9)
    assert main(["--check", str(place)]) == 0
    assert capsys.readouterr().err == ""
