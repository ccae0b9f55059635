"""`cellctl calibrate hand-eye`: reading poses, two streams, and a real arm."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cellctl.__main__ import cli
from cellctl.calibration.errors import UnreadablePoses
from cellctl.calibration.six_dof.pairs import Pairs
from cellctl.calibration.six_dof.rigid import inverse, quaternion_from_rotation, vector_from_rotation
from cellctl.calibration.six_dof.table import read_table
from tests.arm_poses import REAL, looks, real_tables

QUATERNION = ("qx", "qy", "qz", "qw")


def run(*arguments: object):
    return CliRunner().invoke(cli, ["calibrate", "hand-eye", *map(str, arguments)])


def columns(prefix: str, poses: np.ndarray, turn: str = "quaternion") -> dict[str, np.ndarray]:
    named = dict(zip(("x_mm", "y_mm", "z_mm"), poses[:, :3, 3].T, strict=True))
    if turn == "quaternion":
        named |= dict(zip(QUATERNION, quaternion_from_rotation(poses[:, :3, :3]).T, strict=True))
    else:
        vectors = np.degrees(vector_from_rotation(poses[:, :3, :3]))
        named |= dict(zip(("rx_deg", "ry_deg", "rz_deg"), vectors.T, strict=True))
    return {f"{prefix}.{part}": values for part, values in named.items()}


def written(path: Path, table: dict[str, np.ndarray]) -> Path:
    rows = [",".join(table), *(",".join(f"{value:.9g}" for value in row) for row in zip(*table.values(), strict=True))]
    path.write_text("\n".join(["# poses", "", *rows]) + "\n", encoding="utf-8")
    return path


def file_of(path: Path, pairs: Pairs) -> Path:
    return written(path, columns("robot_from_tool", pairs.robot) | columns("camera_from_target", pairs.target))


@pytest.mark.parametrize("mount", ["eye-in-hand", "eye-to-hand"])
def test_a_file_of_poses_gives_the_camera(tmp_path, mount):
    camera, _, pairs = looks(np.random.default_rng(1), mount.replace("-", "_"), 20)
    out = tmp_path / "camera.json"
    result = run(file_of(tmp_path / "poses.csv", pairs), "--mount", mount, "--out", out, "--compare")
    assert result.exit_code == 0, result.output
    assert "one sigma" in result.output
    assert "Daniilidis" in result.output
    carrier = "tool" if mount == "eye-in-hand" else "robot"
    found = json.loads(out.read_text())
    assert found[f"{carrier}_from_camera"]["place_mm"] == pytest.approx(camera[:3, 3], abs=0.15)
    assert next(one["name"] for one in found["compared"]) == "cellctl"


def test_inverted_poses_and_other_rotations_say_the_same(tmp_path):
    _, _, pairs = looks(np.random.default_rng(2), "eye_in_hand", 20)
    first = run(file_of(tmp_path / "a.csv", pairs), "--json")
    other = columns("tool_from_robot", inverse(pairs.robot), "vector") | columns(
        "target_from_camera", inverse(pairs.target)
    )
    second = run(written(tmp_path / "b.csv", other), "--json")
    one, two = (json.loads(result.stdout)["tool_from_camera"]["place_mm"] for result in (first, second))
    assert one == pytest.approx(two, abs=1e-4)


def test_metres_euler_angles_and_a_scaras_r_are_read():
    text = "robot_from_tool.x_m,robot_from_tool.y_m,robot_from_tool.z_m,robot_from_tool.roll_deg,"
    text += "robot_from_tool.pitch_deg,robot_from_tool.yaw_deg\n0.1,0,0,0,0,90\n"
    pose = read_table("a", text).poses["robot_from_tool"][0]
    assert pose[:3, 3] == pytest.approx((100, 0, 0))
    assert pose[:3, 0] == pytest.approx((0, 1, 0), abs=1e-12)
    text = "robot_from_tool.x_mm,robot_from_tool.y_mm,robot_from_tool.z_mm,robot_from_tool.r_deg\n1,2,3,30\n"
    assert vector_from_rotation(read_table("a", text).poses["robot_from_tool"][0][:3, :3]) == pytest.approx(
        (0, 0, np.pi / 6)
    )


def test_a_plan_is_judged_before_the_robot_moves(tmp_path):
    _, _, pairs = looks(np.random.default_rng(3), "eye_in_hand", 15)
    good = run(written(tmp_path / "good.csv", columns("robot_from_tool", pairs.robot)), "--plan")
    assert good.exit_code == 0
    assert "1 mm of noise" in good.output
    flat = pairs.robot.copy()
    flat[:, :3, :3] = np.eye(3)
    bad = run(written(tmp_path / "bad.csv", columns("robot_from_tool", flat)), "--plan")
    assert bad.exit_code == 1
    assert "without rotation the camera's place cannot be found" in bad.output


GOOD = ",".join(f"robot_from_tool.{part}" for part in ("x_mm", "y_mm", "z_mm", *QUATERNION))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "there are no rows"),
        ("1,2,3\n", "poses:1:1: unknown column '1'"),
        (GOOD, "a header and nothing below"),
        (GOOD + "\n1,2,3,0,0,0\n", "poses:2: 6 fields, the header has 7"),
        (GOOD + "\n1,2,x,0,0,0,1\n", r"poses:2:3: robot_from_tool.z_mm must be a number .* \(got 'x'\)"),
        (GOOD + "\n1,2,nan,0,0,0,1\n", "poses:2:3"),
        (GOOD + "\n1,2,3,0,0,0,1\n1,2,3,0,0,0,0\n", "poses:3: a rotation's quaternion must be of length 1"),
        (GOOD + ",robot_from_tool.qx\n", "poses:1:8: column robot_from_tool.qx is there twice"),
        (GOOD.replace("qw", "r_deg") + "\n1,2,3,0,0,0,1\n", "must have three columns for its place"),
        (GOOD + ",tool_from_robot.x_mm\n1,2,3,0,0,0,1,1\n", "are the same pose"),
        ("time_s," + GOOD + "\n1,1,2,3,0,0,0,1\n1,1,2,3,0,0,0,1\n", "poses:3: time_s must grow"),
        ('"' + GOOD, "this is no CSV"),
    ],
)
def test_a_wrong_file_is_refused_with_line_column_and_remedy(text, says):
    with pytest.raises(UnreadablePoses, match=says):
        read_table("poses", text)


pieces = st.sampled_from([GOOD, "\n", ",", "1", "0", "-0.5", "nan", "1e400", '"', "#", "time_s", "\r", "\0", "é", " "])


@given(st.one_of(st.text(max_size=200), st.lists(pieces, max_size=60).map("".join)))
@example(GOOD + "\n1,2,3,0,0,0,1\n")
@settings(max_examples=150, deadline=None)
def test_any_text_is_read_or_refused_with_a_sentence(text):
    refusal = ""
    try:
        table = read_table("poses", text)
    except UnreadablePoses as error:
        refusal = str(error)
    if refusal:
        assert re.match(r"poses(:\d+){0,2}: ", refusal)
    else:
        assert all(np.isfinite(poses).all() for poses in table.poses.values())


def test_files_that_cannot_be_used_are_named(tmp_path):
    missing = run(tmp_path / "none.csv")
    assert missing.exit_code == 1
    assert "cannot be read" in missing.output
    (tmp_path / "picture.csv").write_bytes(b"\xff\xd8\xff\xe0")
    assert "is not a text file" in run(tmp_path / "picture.csv").output
    only = written(tmp_path / "only.csv", columns("robot_from_tool", np.eye(4)[None]))
    refused = run(only, "--json")
    assert json.loads(refused.stdout)["ok"] is False
    assert "there are no columns camera_from_target" in refused.stdout
    assert run(only, only).exit_code == 1
    assert run(only, only, only).exit_code == 2


@pytest.mark.skipif(not REAL.exists(), reason=f"the recording of a real arm is not here ({REAL.name})")
def test_the_real_arms_camera_is_found_from_its_two_streams(tmp_path):
    robot, camera = real_tables(tmp_path)
    result = run(camera, robot, "--json", "--compare")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["robot_ahead_s"] == pytest.approx(-0.016, abs=0.004)
    assert 10 < len(found["left_out"]) < 100
    assert found["used"] > 1500
    assert max(found["sd_mm"]) < 0.5
    ours, *theirs = found["compared"]
    assert ours["place_mm"] < 3.6
    assert all(ours["place_mm"] < one["place_mm"] for one in theirs)
