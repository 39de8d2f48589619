"""Exported files describe themselves, and damaged or foreign files are refused in one line."""

import dataclasses
import json

import numpy as np
import onnx
import pytest
import torch
from onnx import numpy_helper
from tensordict import TensorDict

import small_results
from arrive.build import build_env
from arrive.cli import main
from arrive.deployment import Controller, ControlLog
from arrive.deployment.export import export_policy
from arrive.deployment.onnx_file import PREFIX, SEAL, append_checksum
from arrive.deployment.policy_file import read_policy_file
from arrive.deployment.verify import verify
from arrive.env import POLICY
from arrive.errors import ArriveError
from arrive.learning.policy import load_policy
from arrive.learning.ppo import make_actor
from arrive.learning.symmetry import make_reflections
from arrive.learning.trainer import Trainer
from arrive.task.registry import get_task
from controllers import CONFIG, an_env

SEAL_SIZE = len(append_checksum(b""))


def changed(exported, folder, change, sealed=False):
    """A copy of the exported file with something changed; `sealed` gives it a checksum that agrees."""
    content = exported.read_bytes()
    model = onnx.load_from_string(content)
    text = {entry.key: entry.value for entry in model.metadata_props if entry.key != PREFIX + SEAL}
    change(model, text)
    onnx.helper.set_model_props(model, text)
    body = model.SerializeToString()
    (folder / "changed.onnx").write_bytes(append_checksum(body) if sealed else body + content[-SEAL_SIZE:])
    return folder / "changed.onnx"


def edit(section, change):
    def apply(model, text):
        value = json.loads(text[PREFIX + section])
        change(value)
        text[PREFIX + section] = json.dumps(value)

    return apply


def flip(index):
    """Turn the sign of one weight of the first layer."""

    def apply(model, text):
        weights = numpy_helper.to_array(first_layer(model)).copy()
        weights[0, index] *= -1
        first_layer(model).CopyFrom(numpy_helper.from_array(weights, "w0"))

    return apply


def swap_slices(terms):
    terms[0]["name"], terms[1]["name"] = terms[1]["name"], terms[0]["name"]


def test_exported_file_explains_itself(exported, capsys):
    file = verify(exported)
    assert file.terms[3].name == "target"
    assert (file.terms[3].start, file.terms[3].stop, file.terms[3].unit, file.terms[3].frame) == (9, 12, "m", "base")
    assert file.robot.joint_names[:3] == ["LF_HAA", "LF_HFE", "LF_KFE"]
    assert file.robot.joint_limits_rad[0] == [-0.72, 0.49]
    assert len(file.meta["golden"]["actions"]) == 16
    assert file.meta["evaluation"] is None
    main(["verify", str(exported)])
    assert "16 golden pairs reproduced" in capsys.readouterr().out


def test_the_exported_file_has_the_evaluation(run, tmp_path):
    summary = small_results.difficulty()
    (tmp_path / "difficulty.json").write_text(json.dumps(summary))
    del summary["policy"]
    (tmp_path / "policy.pt").write_bytes((run / "policy.pt").read_bytes())
    export_policy(load_policy(tmp_path), tmp_path / "policy.onnx")
    assert read_policy_file(tmp_path / "policy.onnx").meta["evaluation"] == summary


@pytest.mark.parametrize(
    ("change", "sealed", "message"),
    [
        (flip(0), False, "was changed after the export"),
        (flip(0), True, "does not reproduce its golden pairs"),
        (edit("observation", swap_slices), False, "was changed after the export"),
        (edit("observation", swap_slices), True, r"observation\[0\]"),
        (edit("observation", lambda terms: terms[4].update(scale=1.0)), True, r"observation\[4\].scale"),
        (edit("observation", lambda terms: terms[4].update(stop=14)), True, "slice"),
        (edit("observation", lambda terms: terms.pop()), True, "has 320 observations"),
        (edit("robot", lambda robot: robot.update(stiffness=90.0)), True, r"robot.stiffness is 90.0, not 80.0"),
        (edit("robot", lambda robot: robot["joint_names"].reverse()), True, r"robot.joint_names\[0\]"),
        (edit("robot", lambda robot: robot.pop("damping")), True, "damaged"),
        (edit("control", lambda control: control.update(period_s=0.01)), True, "control.period_s"),
        (edit("golden", lambda golden: golden["actions"][0].__setitem__(0, 9.0)), True, "golden actions differ"),
        (lambda model, text: text.pop(PREFIX + "task"), True, "lacks the metadata task"),
        (lambda model, text: text.update({PREFIX + "format": "99"}), True, "export format 99"),
        (lambda model, text: text.clear(), True, "not a policy of arrive: it has no metadata"),
    ],
)
def test_verify_refuses_what_was_changed(exported, tmp_path, change, sealed, message):
    with pytest.raises(ArriveError, match=message):
        verify(changed(exported, tmp_path, change, sealed))


def test_every_weight_counts_even_one_too_small_for_the_golden_pairs(exported, tmp_path):
    def nudge(model, text):
        weights = numpy_helper.to_array(first_layer(model)).copy()
        weights[0, 0] = np.nextafter(weights[0, 0], np.float32(9))
        first_layer(model).CopyFrom(numpy_helper.from_array(weights, "w0"))

    with pytest.raises(ArriveError, match="was changed after the export"):
        verify(changed(exported, tmp_path, nudge))


@pytest.mark.parametrize("content", [b"", b"hello", None], ids=["empty", "foreign", "truncated"])
def test_corrupt_files_are_refused_in_one_line(exported, tmp_path, content, capsys):
    path = tmp_path / "bad.onnx"
    path.write_bytes(exported.read_bytes()[:5000] if content is None else content)
    with pytest.raises(ArriveError, match=r"not a policy of arrive: it is truncated, corrupt"):
        Controller.load(path)
    with pytest.raises(SystemExit):
        main(["verify", str(path)])
    assert capsys.readouterr().err.count("\n") == 1


def test_every_flipped_bit_is_noticed(small, tmp_path):
    """1,000 single bits of a whole file, weights, metadata and checksum alike."""
    content, rng = small.read_bytes(), np.random.default_rng(3)
    path = tmp_path / "flipped.onnx"
    # The checksum and the bytes before it too, which random places would seldom meet.
    places = [*rng.integers(8 * len(content), size=900), *(8 * len(content) - 1 - rng.integers(8 * 100, size=100))]
    for place in places:
        flipped = bytearray(content)
        flipped[place // 8] ^= 1 << place % 8
        path.write_bytes(flipped)
        with pytest.raises(ArriveError, match=r"Export the policy again|not a policy of arrive"):
            read_policy_file(path)


def test_every_truncation_is_noticed(small, tmp_path):
    content = small.read_bytes()
    for size in np.random.default_rng(4).integers(len(content), size=100):
        (tmp_path / "cut.onnx").write_bytes(content[:size])
        with pytest.raises(ArriveError):
            read_policy_file(tmp_path / "cut.onnx")


@pytest.fixture(scope="module")
def small(run, tmp_path_factory):
    """An export of a network with 8 hidden neurons."""
    policy = load_policy(run)
    torch.manual_seed(0)
    sample = TensorDict({POLICY: torch.zeros(1, policy.schema[-1]["stop"])}, batch_size=[1])
    actor = make_actor(
        dataclasses.replace(policy.config.ppo, hidden=(8,)), sample, 12, make_reflections(an_env("flat"))
    )
    path = tmp_path_factory.mktemp("small") / "small.onnx"
    export_policy(dataclasses.replace(policy, actor=actor), path)
    return path


def put(section, *places_and_value):
    """An edit that puts a value at a place of a section."""
    *places, value = places_and_value

    def change(content):
        for place in places[:-1]:
            content = content[place]
        content[places[-1]] = value

    return edit(section, change)


NAN, INFINITE = float("nan"), float("inf")
HOSTILE = {
    "NaN limit": (put("robot", "joint_limits_rad", 0, [NAN, 0.5]), "NaN is not a number"),
    "infinite limit": (put("robot", "joint_limits_rad", 0, [-INFINITE, 0.5]), "Infinity is not a number"),
    "huge limit": (put("robot", "joint_limits_rad", 0, [-1e300, 1e300]), "not in radians"),
    "reversed limits": (put("robot", "joint_limits_rad", 0, [0.5, -0.5]), "range of LF_HAA .* ascending"),
    "zero limits": (put("robot", "joint_limits_rad", 0, [0.0, 0.0]), "range of LF_HAA"),
    "limits in text": (put("robot", "joint_limits_rad", 0, ["-1", "1"]), "not a finite number"),
    "one limit": (put("robot", "joint_limits_rad", 0, [1.0]), "list of 2 numbers"),
    "eleven limits": (edit("robot", lambda robot: robot["joint_limits_rad"].pop()), "12 ranges"),
    "pose outside": (put("robot", "default_joint_pos_rad", 0, 3.0), "default position of LF_HAA"),
    "no pose": (put("robot", "default_joint_pos_rad", []), "list of 12 numbers"),
    "zero scale": (put("robot", "action_scale_rad", 0.0), "robot.action_scale_rad"),
    "negative scale": (put("robot", "action_scale_rad", -0.5), "robot.action_scale_rad"),
    "true stiffness": (put("robot", "stiffness", True), "robot.stiffness is True"),
    "zero stiffness": (put("robot", "stiffness", 0), "robot.stiffness"),
    "negative damping": (put("robot", "damping", -2.0), "robot.damping"),
    "zero effort": (put("robot", "effort_limit", 0.0), "robot.effort_limit"),
    "stall below effort": (put("robot", "stall_torque", 10.0), "stall_torque is below"),
    "negative speed": (put("robot", "no_load_speed", -7.5), "robot.no_load_speed"),
    "a number too large": (put("robot", "standing_height_m", 10**400), "damaged|standing_height"),
    "same names": (put("robot", "joint_names", 1, "LF_HAA"), "twice"),
    "zero period": (put("control", "period_s", 0), "control.period_s"),
    "no period": (edit("control", lambda control: control.clear()), "damaged"),
    "zero episode": (put("task", "episode_s", 0.0), "task.episode_s"),
    "negative window": (put("task", "reward_window_s", -1.0), "task.reward_window_s"),
    "window beyond the episode": (put("task", "reward_window_s", 99.0), "task.reward_window_s"),
    "reversed distances": (put("task", "target_distance_m", [5.0, 1.0]), "task.target_distance_m"),
    "text for a radius": (put("task", "arrival_radius_m", "0.5"), "task.arrival_radius_m"),
    "zero observation scale": (put("observation", 4, "scale", 0.0), "scale of observation 'time_left'"),
    "half a number": (put("observation", 0, "stop", 3.0), "slice of observation"),
    "negative slice": (put("observation", 0, "stop", -3), "slice of observation"),
    "two of a name": (put("observation", 0, "name", "base_ang_vel"), "same name"),
    "zero grid step": (put("heights", "step_m", 0.0), "heights.step_m"),
    "a point elsewhere": (put("heights", "points_m", 5, [9.0, 9.0]), "not a complete grid"),
    "no points": (put("heights", "points_m", []), "heights.points_m"),
    "no samples": (put("heights", "samples", 0), "heights.samples"),
    "half a sample": (put("heights", "samples", 0.5), "heights.samples"),
    "squares that do not fit": (put("heights", "samples", 5), "heights.samples is 5, which does not divide a grid"),
    "other squares": (put("heights", "samples", 1), "heights"),
    "clips of one side": (put("heights", "clip_m", [0.1, 0.4]), "heights.clip_m"),
    "no feet": (edit("robot", lambda robot: robot.pop("feet")), "must both be given"),
    "nothing around the feet": (put("heights", "foot_points_m", []), "must both be given"),
    "places in space": (put("heights", "foot_points_m", 3, [0.0, 30.0]), r"foot_points_m\[3\]"),
    "a foot too few": (edit("robot", lambda robot: robot["feet"].pop()), "foot_heights"),
    "a foot of no joints": (put("robot", "feet", 1, "links", []), r"robot.feet\[1\] has the joints \[\]"),
    "a joint of another robot": (put("robot", "feet", 1, "links", 0, "joint", "ELBOW"), "ELBOW"),
    "a joint twice": (put("robot", "feet", 1, "links", 0, "joint", "LH_HFE"), "1 to 20 different"),
    "a leg in mm": (put("robot", "feet", 1, "links", 2, "pos_m", [0.0, 0.1, -285.0]), "LH_KFE: pos_m"),
    "a long axis": (put("robot", "feet", 0, "links", 0, "axis", [1.0, 1.0, 0.0]), "not of length 1"),
    "an axis in a plane": (put("robot", "feet", 0, "links", 0, "axis", [1.0, 0.0]), "axis is not a list of 3 numbers"),
    "a foot without a place": (edit("robot", lambda robot: robot["feet"][0].pop("foot_m")), "damaged"),
    "golden zeros": (
        edit("golden", lambda golden: golden.update({x: (0 * np.array(golden[x])).tolist() for x in GOLDEN})),
        "golden.observations are all the same",
    ),
    "one golden pair": (
        edit("golden", lambda golden: golden.update({x: golden[x][:1] for x in GOLDEN})), "at least two rows"
    ),
    "no golden pairs": (edit("golden", lambda golden: golden.update({x: [] for x in GOLDEN})), "at least two rows"),
    "a list for a section": (lambda model, text: text.update({PREFIX + "robot": "[]"}), "damaged"),
    "a number for a section": (lambda model, text: text.update({PREFIX + "observation": "3"}), "damaged"),
    "deep JSON": (lambda model, text: text.update({PREFIX + "golden": "[" * 100_000}), "damaged"),
}  # fmt: skip
GOLDEN = ("observations", "actions")


@pytest.mark.parametrize(("change", "message"), HOSTILE.values(), ids=HOSTILE)
def test_implausible_values_are_refused_even_with_a_valid_checksum(small, tmp_path, change, message):
    with pytest.raises(ArriveError, match=message):
        Controller.load(changed(small, tmp_path, change, sealed=True))


def external(location):
    def apply(model, text):
        tensor = first_layer(model)
        onnx.external_data_helper.set_external_data(tensor, location, offset=0, length=len(tensor.raw_data))
        tensor.ClearField("raw_data")

    return apply


def huge(model, text):
    """A constant of 80 GB in a file of some kB."""
    del first_layer(model).dims[:]
    first_layer(model).dims.extend([100_000, 200_000])


def with_operator(operator, domain=""):
    def apply(model, text):
        model.graph.node.append(onnx.helper.make_node(operator, ["observation"], ["more"], domain=domain))

    return apply


def with_node(operator, inputs, **attributes):
    def apply(model, text):
        model.graph.node.append(onnx.helper.make_node(operator, inputs, ["more"], **attributes))

    return apply


def weight(value):
    def apply(model, text):
        weights = numpy_helper.to_array(first_layer(model)).copy()
        weights[0, 0] = value
        first_layer(model).CopyFrom(numpy_helper.from_array(weights, "w0"))

    return apply


def with_constant(model, text):
    """A tensor in a node's attribute, where another check of sizes would be needed."""
    value = numpy_helper.from_array(np.zeros(3, np.float32))
    model.graph.node[0].attribute.append(onnx.helper.make_attribute("value", value))


def first_layer(model):
    return next(tensor for tensor in model.graph.initializer if tensor.name == "w0")


def doubles(model, text):
    first = first_layer(model)
    first.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(first).astype(np.float64), first.name))


NETWORKS = {
    "external data": (external("weights.bin"), "external data"),
    "external data by path": (external("/etc/passwd"), "external data"),
    "huge": (huge, r"declared as \[100000, 200000\]"),
    "other operator": (with_operator("Relu"), "operator 'Relu'"),
    "foreign operator": (with_operator("Gemm", "com.example"), "foreign operator"),
    "foreign set": (lambda m, t: m.opset_import.append(onnx.helper.make_opsetid("com.example", 1)), "foreign"),
    "constant": (with_constant, "AttributeProto has a tensor"),
    "product of constants": (with_node("Mul", ["w0", "w0"]), "works on constants"),
    "spread constants": (with_node("Mul", ["observation", "w0"]), "'w0' have 2 dimensions"),
    "rows of a matrix": (with_node("Gather", ["w0", "o0_index"], axis=1), "works on constants"),
    "rows of the batch": (with_node("Gather", ["observation", "o0_index"], axis=0), "other attributes"),
    "turned layer": (with_node("Gemm", ["observation", "w0"], transA=1), "other attributes"),
    "function": (lambda m, t: m.functions.add(), "functions of its own"),
    "NaN weight": (weight(np.nan), "not finite"),
    "infinite weight": (weight(np.inf), "not finite"),
    "other weight": (weight(1e37), "golden actions differ"),
    "doubles": (doubles, "neither 32-bit"),
    "a loop": (lambda m, t: m.graph.node[-1].input.__setitem__(1, "action"), "onnxruntime cannot run"),
    "other input": (lambda m, t: setattr(m.graph.input[0], "name", "x"), "onnxruntime cannot run|must map"),
}


@pytest.mark.parametrize(("change", "message"), NETWORKS.values(), ids=NETWORKS)
def test_networks_that_no_export_writes_are_refused(small, tmp_path, change, message, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "weights.bin").write_bytes(bytes(100_000))
    path = changed(small, tmp_path, change, sealed=True)
    for read in (Controller.load, verify):
        with pytest.raises(ArriveError, match=message):
            read(path)


def test_random_bytes_with_a_valid_checksum_are_refused_in_one_line(small, tmp_path):
    """500 damages that someone has sealed again: one line says what is wrong, or the policy still runs."""
    body, rng, messages = small.read_bytes()[:-SEAL_SIZE], np.random.default_rng(5), []
    for _ in range(500):
        damaged = bytearray(body)
        # Most of a file are numbers of weights and golden pairs; the structure is at the beginning and between them.
        for place in rng.integers(len(damaged), size=2):
            damaged[place] = rng.integers(256)
        start = rng.integers(0, 400)
        damaged[start : start + rng.integers(0, 4)] = rng.bytes(rng.integers(0, 4))
        (tmp_path / "damaged.onnx").write_bytes(append_checksum(bytes(damaged)))
        messages.append(refusal(tmp_path / "damaged.onnx"))
    assert not [message for message in messages if "\n" in message]
    assert sum(map(bool, messages)) > 350


def refusal(path) -> str:
    """Why a file is not loaded, empty where it is."""
    try:
        Controller.load(path)
    except ArriveError as error:
        return str(error)
    return ""


def test_a_file_of_the_previous_format_is_refused_with_the_reason(exported, tmp_path):
    (tmp_path / "old.onnx").write_bytes(exported.read_bytes()[:-SEAL_SIZE])
    with pytest.raises(ArriveError, match="truncated, or of another version of arrive"):
        read_policy_file(tmp_path / "old.onnx")


def test_a_failed_export_keeps_the_existing_file(run, tmp_path, monkeypatch):
    out = tmp_path / "policy.onnx"
    out.write_bytes(b"before")

    def full(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("arrive.files.os.fsync", full)
    with pytest.raises(ArriveError, match=r"cannot write .*policy.onnx: .*No space left.* Free some space"):
        export_policy(load_policy(run), out)
    log = ControlLog()
    with pytest.raises(ArriveError, match="No space left"):
        log.save(out)
    assert out.read_bytes() == b"before"
    assert [path.name for path in tmp_path.iterdir()] == ["policy.onnx"]


def test_labels_of_cells_may_be_rounded_but_not_moved(exported, tmp_path):
    def rounded(terms):
        terms[-1]["labels"] = [f"({float(x):.1f}, {float(y):.1f})" for x, y in
                              (label.strip("()").split(",") for label in terms[-1]["labels"])]  # fmt: skip

    verify(changed(exported, tmp_path, edit("observation", rounded), sealed=True))
    moved = put("observation", 9, "labels", 3, "(5.0, 5.0)")
    with pytest.raises(ArriveError, match=r"observation\[9\].labels\[3\] is '\(5.0, 5.0\)', not"):
        verify(changed(exported, tmp_path, moved, sealed=True))


def test_export_refuses_a_network_that_is_broken(run, tmp_path):
    policy = load_policy(run)
    with torch.no_grad():
        policy.actor.mlp[0].weight[0, 0] = torch.nan
    with pytest.raises(ArriveError, match="not finite"):
        export_policy(policy, tmp_path / "policy.onnx")
    assert not list(tmp_path.iterdir())


def test_missing_file_is_named(tmp_path):
    with pytest.raises(ArriveError, match="there is no file"):
        Controller.load(tmp_path / "none.onnx")


def test_velocity_policy_can_be_exported_but_not_driven_to_targets(tmp_path):
    config = dataclasses.replace(CONFIG, task=get_task("velocity").from_preset(CONFIG.task))
    Trainer(config, build_env(config, threads=1), tmp_path).save()
    export_policy(load_policy(tmp_path), tmp_path / "v.onnx")
    verify(tmp_path / "v.onnx")
    with pytest.raises(ArriveError, match="speed_command"):
        Controller.load(tmp_path / "v.onnx")
