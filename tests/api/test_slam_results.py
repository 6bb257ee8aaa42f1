"""A comparison with a SLAM, from the command line to the Python API: answers and corrected poses stay apart."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import evalkit
from evalkit.cli import app
from evalkit.core.errors import StoreError
from evalkit.io.tum import read_tum

EXPERIMENT = """
title = "wheels and a SLAM"
mapper.scans = 4

[[method]]
use = "wheel-odometry"

[[method]]
use = "faulty-slam"
label = "slam"

[[sequence]]
use = "straight"
scans = 12
"""


def test_answers_and_corrected_poses_are_scored_stored_and_read_apart(tmp_path, strangers):
    file, out = tmp_path / "slam.toml", tmp_path / "out"
    file.write_text(EXPERIMENT)
    for words in ((), ("--collect", "--no-page")):
        ended = CliRunner().invoke(app, ["compare", str(file), "--out", str(out), *words])
        assert ended.exit_code == 0, ended.output
    results = evalkit.load(out)
    answers, corrected = results.trajectory("slam"), results.trajectory("slam", final=True)
    np.testing.assert_allclose(answers.poses[:, 1], 0.0, atol=1e-12)
    np.testing.assert_array_equal(corrected.poses[:, 1], [0.0, *[0.01] * 11])
    aligned = results.trajectory("slam", final=True, aligned=True)
    assert (aligned.parent, len(aligned)) == ("world", 12)
    assert [one.accepted for one in results.loop_closures("slam")] == [False, True]
    with pytest.raises(StoreError, match="this run has no corrected poses"):
        results.trajectory("wheel-odometry", final=True)
    scores = results.scores().set_index("method")
    # 11 of 12 poses 1 cm to the left of the first one; the alignment turns and shifts: less than 1 cm remains
    assert scores.loc["slam", "ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert 0.001 < scores.loc["slam", "final_ate_rmse_m"] < 0.01
    assert np.isnan(scores.loc["wheel-odometry", "final_ate_rmse_m"])
    assert (scores.loc["slam", "closures_accepted"], scores.loc["slam", "corrections"]) == (1.0, 1.0)
    assert scores.loc["slam", "closure_precision_percent"] == 100.0
    (run,) = [one for one in results.content["runs"] if one["method"] == "slam"]
    tum = read_tum(out / "trajectories" / f"{run['key']}.final.tum").trajectory
    np.testing.assert_allclose(tum.poses, corrected.poses, atol=1e-8)
    stored = json.loads((out / "runs" / run["key"] / "result.json").read_text())
    assert {"steps.bin", "final.npy", "loop_closures.json", "path_corrections.npy"} == set(stored["files"])
    damaged = out / "runs" / run["key"] / "final.npy"
    damaged.write_bytes(damaged.read_bytes()[:-1])
    with pytest.raises(StoreError, match=r"incomplete: 0 of 12 poses \(final.npy is damaged"):
        results.trajectory("slam")
