"""Actuator networks: their torque, and their files."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file, save_file
from torch import nn

from actuator_networks import lstm, taps
from arrive.actuation.conversion import read_lstm_arrays
from arrive.actuation.modules import LstmModule, TapsModule
from arrive.actuation.network import ActuatorNetwork
from arrive.actuation.network_file import read_network, write_network
from arrive.actuation.runtime import make_runtime
from arrive.errors import ArriveError
from loading import ROOT

PUBLISHED = ROOT.parent / "shared" / "actuators"
MANY = 1100
"""Joints: more than two blocks of columns, and the last one not full."""


def from_module(module: nn.Module, architecture: str, **changes) -> ActuatorNetwork:
    weights = {name: value.detach().numpy().copy() for name, value in module.state_dict().items()}
    return ActuatorNetwork(architecture, weights, 0.005, 2.0, 0.25, 20.0, **changes)


MODULES: dict[str, Callable[[], tuple[nn.Module, dict]]] = {
    "lstm": lambda: (LstmModule(8, 2), {}),
    "one layer": lambda: (LstmModule(5, 1), {}),
    "three layers": lambda: (LstmModule(4, 3), {}),
    "taps": lambda: (TapsModule((0, 2, 4)), {"taps_s": (0.0, 0.01, 0.02)}),
    "one late tap": lambda: (TapsModule((3,), (6,)), {"taps_s": (0.015,)}),
}


@pytest.mark.parametrize("kind", MODULES)
def test_numpy_gives_the_same_torque_as_torch_for_every_joint(kind):
    torch.manual_seed(0)
    module, changes = MODULES[kind]()
    network = from_module(module, "lstm" if isinstance(module, LstmModule) else "taps", **changes)
    rng = np.random.default_rng(0)
    error, velocity = rng.normal(0, 0.3, (30, MANY)), rng.normal(0, 3.0, (30, MANY))
    inputs = torch.from_numpy(np.stack([2.0 * error, 0.25 * velocity], axis=-1)).float().transpose(0, 1)
    with torch.no_grad():
        expected = 20.0 * module(inputs).T.numpy()
    runtime = make_runtime(network, MANY)
    torque = np.array([runtime.step(e, v).copy() for e, v in zip(error, velocity, strict=True)])
    np.testing.assert_allclose(torque, expected, atol=2e-5)
    assert np.ptp(expected) > 1.0


def test_the_published_lstm_reproduces_its_reference_torques(tmp_path):
    """Through a file of our own; 400 steps of 8 joints, within 1e-4 N m (measured 2e-5)."""
    if not PUBLISHED.is_dir():
        pytest.skip("the published network is not beside this checkout (../shared/actuators)")
    network = read_lstm_arrays(PUBLISHED / "anydrive_v3_lstm.npz", 0.005, "ANYdrive 3, legged_gym")
    write_network(tmp_path / "published.safetensors", network)
    runtime = make_runtime(read_network(tmp_path / "published.safetensors", 0.005), 8)
    with np.load(PUBLISHED / "anydrive_v3_lstm_reference.npz") as reference:
        steps = zip(reference["position_error_rad"], reference["velocity_rad_s"], strict=True)
        torque = np.array([runtime.step(error, velocity).copy() for error, velocity in steps])
        np.testing.assert_allclose(torque, reference["torque_nm"], atol=1e-4, rtol=0.0)


class TestFile:
    @pytest.mark.parametrize("make", [lstm, taps])
    def test_a_saved_file_is_read_back_unchanged(self, make, tmp_path):
        path = tmp_path / "new" / "drive.safetensors"
        network = make(data="a test", error_nm=1.25)
        write_network(path, network)
        back = read_network(path, 0.005)
        for name in ("architecture", "period_s", "error_scale", "velocity_scale", "torque_scale", "taps_s", "data"):
            assert getattr(back, name) == getattr(network, name), name
        assert back.error_nm == 1.25
        assert back.units == network.units
        assert all(np.array_equal(back.weights[name], array) for name, array in network.weights.items())

    def test_every_flipped_bit_is_noticed(self, tmp_path):
        path = tmp_path / "drive.safetensors"
        write_network(path, lstm(data="a test"))
        content = path.read_bytes()
        for bit in np.random.default_rng(3).choice(8 * len(content), 500, replace=False):
            damaged = bytearray(content)
            damaged[bit // 8] ^= 1 << bit % 8
            path.write_bytes(damaged)
            with pytest.raises(ArriveError):
                read_network(path)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"units": {"position_error": "deg"}}, "its units are .*deg.*where .*rad.* are needed"),
            ({"format": "arrive-actuator-9"}, "no actuator network of the format arrive-actuator-1"),
            ({"architecture": "gru"}, "unknown architecture 'gru'. .*lstm, taps"),
            ({"hidden_units": [8, 8]}, r"says \[8, 8\] hidden units and has \[5, 3\]"),
            ({"taps_s": [0.0, 0.012, 0.02]}, "a tap of 0.012 s is no multiple"),
            ({"taps_s": [0.0, 0.01]}, r"layers.0.weight is float32 \(5, 6\), where float32 \(5, 4\) is needed"),
            ({"taps_s": []}, "only the architecture `taps` has taps_s"),
            ({"period_s": 0}, "period_s must be positive and finite, not 0.0"),
            ({"torque_scale": float("nan")}, "torque_scale must be positive and finite, not nan"),
            ({"period_s": "soon"}, "no number where one is needed"),
            ({"velocity_scale": None}, "no number where one is needed"),
        ],
    )
    def test_another_description_is_refused(self, change, message, tmp_path):
        path = self.changed(tmp_path, lambda weights: weights, change)
        with pytest.raises(ArriveError, match=message) as raised:
            read_network(path)
        assert str(raised.value).startswith(f"{path}: ")
        assert "\n" not in str(raised.value)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda w: w | {"layers.1.weight": np.full((3, 5), np.nan, np.float32)}, "layers.1.weight has values"),
            (lambda w: w | {"layers.1.bias": w["layers.1.bias"].astype(np.float64)}, "float64 .*where float32"),
            (lambda w: w | {"layers.1.weight": np.zeros((3, 4), np.float32)}, r"\(3, 4\), where float32 \(3, 5\)"),
            (lambda w: w | {"extra": np.zeros(1, np.float32)}, "unknown array extra"),
            (lambda w: {name: a for name, a in w.items() if name != "layers.0.bias"}, "no array layers.0.bias"),
            (lambda w: {}, "1 to 8 layers, not 0"),
        ],
    )
    def test_other_arrays_are_refused(self, change, message, tmp_path):
        path = self.changed(tmp_path, change, {})
        with pytest.raises(ArriveError, match=message) as raised:
            read_network(path)
        assert str(raised.value).startswith(f"{path}: ")

    @pytest.mark.parametrize(
        "damage", [lambda c: c[:200], lambda c: c[:-7], lambda c: b"PK\x03\x04" + c, lambda c: b""]
    )
    def test_a_damaged_file_is_refused(self, damage, tmp_path):
        path = tmp_path / "drive.safetensors"
        write_network(path, taps())
        path.write_bytes(damage(path.read_bytes()))
        with pytest.raises(ArriveError, match="no safetensors file, or a damaged one"):
            read_network(path)

    def test_files_of_another_kind_are_refused(self, tmp_path):
        with pytest.raises(ArriveError, match="no such file; `arrive actuator fit` makes one"):
            read_network(tmp_path / "nothing.safetensors")
        save_file({"a": np.zeros(2, np.float32)}, tmp_path / "other.safetensors", {"author": "somebody"})
        with pytest.raises(ArriveError, match="metadata are not those of an actuator network"):
            read_network(tmp_path / "other.safetensors")
        save_file({"a": np.zeros(2, np.float32)}, tmp_path / "bare.safetensors")
        with pytest.raises(ArriveError, match=r"no actuator network of the format .*lacks format, architecture"):
            read_network(tmp_path / "bare.safetensors")

    @staticmethod
    def changed(folder: Path, change_weights: Callable[[dict], dict], change: dict) -> Path:
        """A file whose arrays or description somebody has changed."""
        path = folder / "drive.safetensors"
        write_network(path, taps())
        size = int.from_bytes(path.read_bytes()[:8], "little")
        text = json.loads(path.read_bytes()[8 : 8 + size])["__metadata__"]
        text |= {name: json.dumps(value) for name, value in change.items()}
        save_file(change_weights(load_file(path)), path, text)
        return path


class TestImport:
    def test_takes_arrays_with_their_scales(self, tmp_path):
        network = lstm(error_scale=2.0, velocity_scale=0.25, torque_scale=20.0)
        scales = {"in_scale": np.array([[[2.0, 0.25]]]), "out_scale": np.array([20.0])}
        np.savez(tmp_path / "arrays.npz", **network.weights, **scales)
        back = read_lstm_arrays(tmp_path / "arrays.npz", 0.005, "")
        runtimes = [make_runtime(each, 1) for each in (network, back)]
        torques = [runtime.step(np.array([0.2]), np.array([-1.0]))[0] for runtime in runtimes]
        assert torques[0] == torques[1] != 0.0

    def test_refuses_others(self, tmp_path):
        path = tmp_path / "arrays.npz"
        np.savez(path, **lstm().weights)
        with pytest.raises(ArriveError, match="in_scale must have two values"):
            read_lstm_arrays(path, 0.005, "")
        np.savez(path, in_scale=np.ones(2), out_scale=np.ones(1), **taps().weights)
        with pytest.raises(ArriveError, match=r"arrays.npz: .*1 to 8 layers, not 0"):
            read_lstm_arrays(path, 0.005, "")
        path.write_bytes(b"nothing")
        with pytest.raises(ArriveError, match="cannot read"):
            read_lstm_arrays(path, 0.005, "")
