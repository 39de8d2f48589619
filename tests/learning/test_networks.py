"""Networks with bfloat16 hidden layers: the same parameters, nearly the same outputs and gradients."""

import pytest
import torch
from tensordict import TensorDict

from arrive.learning.networks import MixedPrecision, Network, choose_precision

SIZE = 40


def a_model(precision: str, seed: int = 1) -> Network:
    torch.manual_seed(seed)
    observation = TensorDict({"policy": torch.zeros(1, SIZE)}, batch_size=[1])
    return Network(observation, {"actor": ["policy"]}, "actor", 3, hidden_dims=[64, 32], precision=precision)


def observations(n: int = 50) -> TensorDict:
    generator = torch.Generator().manual_seed(2)
    return TensorDict({"policy": torch.randn(n, SIZE, generator=generator)}, batch_size=[n])


def test_parameters_have_the_same_names_and_values_so_that_files_are_interchangeable():
    full, mixed = a_model("float32"), a_model("bfloat16")
    assert full.state_dict().keys() == mixed.state_dict().keys()
    assert all(torch.equal(full.state_dict()[name], value) for name, value in mixed.state_dict().items())
    assert isinstance(mixed.mlp, MixedPrecision)


def test_outputs_are_float32_and_within_the_rounding_of_bfloat16():
    full, mixed = a_model("float32")(observations()), a_model("bfloat16")(observations())
    assert mixed.dtype == torch.float32
    assert not torch.equal(full, mixed)
    assert float((full - mixed).detach().abs().max()) < 0.02 * float(full.detach().abs().max())


def test_gradients_reach_every_float32_parameter_and_agree():
    full, mixed = a_model("float32"), a_model("bfloat16")
    for model in (full, mixed):
        model(observations()).square().mean().backward()
    for (name, a), b in zip(full.named_parameters(), mixed.parameters(), strict=True):
        assert b.grad.dtype == torch.float32
        assert torch.cosine_similarity(a.grad.flatten(), b.grad.flatten(), dim=0) > 0.999, name


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_a_named_precision_is_kept(precision):
    assert choose_precision(precision) == precision


@pytest.mark.parametrize(("has_it", "chosen"), [(True, "bfloat16"), (False, "float32")])
def test_auto_takes_bfloat16_only_where_the_processor_has_it(monkeypatch, has_it, chosen):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": has_it})
    assert choose_precision("auto") == chosen
    monkeypatch.setattr(torch.cpu, "get_capabilities", dict)
    assert choose_precision("auto") == "float32"
