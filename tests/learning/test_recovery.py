"""Recovery from NaN: stop, save a dump, go back, continue."""

import math
import signal

import pytest
import torch

from arrive.errors import ArriveError
from arrive.learning.interrupt import interruptible
from arrive.learning.logs import RunLog
from arrive.learning.recovery import MAX_RECOVERIES
from arrive.learning.trainer import Budget
from training_runs import STEPS, differing, log_rows, make_trainer, run, saved_state


def spoil_term(trainer, name: str, env_id: int, when) -> None:
    """Make a reward term NaN for one robot whenever `when()` says so."""
    terms = trainer.env.rewarder.terms
    term = terms[name]

    def spoilt(*args):
        values = term(*args).clone()
        if when():
            values[env_id] = math.nan
        return values

    terms[name] = spoilt


def only_dump(folder) -> dict:
    (path,) = folder.glob("dump_*.pt")
    return torch.load(path, weights_only=True)


def test_a_reward_of_nan_stops_the_update_and_training_goes_on(tmp_path, capsys):
    """A NaN in a reward stops the iteration before the update; training goes on from the last good state."""
    folder = tmp_path / "run"
    trainer = make_trainer(folder)
    before = [value.clone() for value in trainer.algorithm.actor.parameters()]
    calls = iter(range(10**9))
    spoil_term(trainer, "torque_cost", env_id=3, when=lambda: next(calls) == 0)
    seen = []
    recover = trainer.recovery.go_back

    def look(error):
        parameters = trainer.algorithm.actor.parameters()
        seen.append(all(torch.equal(a, b) for a, b in zip(parameters, before, strict=True)))
        recover(error)

    trainer.recovery.go_back = look
    assert run(trainer, 3) == [1, 2, 3]
    assert seen == [True], "the networks were updated with the spoilt batch"
    dump = only_dump(folder)
    assert "torque_cost in environments 3" in dump["what"]
    assert dump["values"]["torque_cost"].isnan().nonzero().flatten().tolist() == [3]
    assert dump["state"]["iteration"] == 0
    assert "torque_cost in environments 3" in capsys.readouterr().out
    assert all(value.isfinite().all() for value in trainer.algorithm.actor.parameters())


@pytest.mark.parametrize("broken", ["actor mlp.0.weight", "critic mlp.2.bias", "actor distribution.log_std_param"])
def test_a_broken_network_is_replaced_by_the_last_good_one(tmp_path, broken):
    folder = tmp_path / "run"
    trainer = make_trainer(folder)
    reported, done = [], []

    def report(result):
        reported.append(result.iteration)
        if result.iteration == 2 and not done:
            network, name = broken.split()
            parameter = dict(getattr(trainer.algorithm, network).named_parameters())[name]
            parameter.data.view(-1)[0] = math.nan
            done.append(True)

    trainer.train(Budget(iterations=4), report)
    assert reported == [1, 2, 1, 2, 3, 4]
    dump = only_dump(folder)
    assert "non-finite" in dump["what"]
    assert dump["state"]["iteration"] == 0
    for network in (trainer.algorithm.actor, trainer.algorithm.critic):
        assert all(value.isfinite().all() for value in network.parameters())


@pytest.mark.parametrize("iteration", [0, 2])
def test_a_run_ends_if_nan_returns_after_every_recovery(tmp_path, iteration):
    """Also where good iterations lie between the state to go back to and the one that goes wrong."""
    trainer = make_trainer(tmp_path / "run")
    spoil_term(trainer, "task", 3, when=lambda: trainer.state.iteration == iteration)
    tries, recover = [], trainer.recovery.go_back

    def counting(error):
        tries.append(error)
        assert len(tries) <= MAX_RECOVERIES + 1, "it would go on for ever"
        recover(error)

    trainer.recovery.go_back = counting
    with pytest.raises(ArriveError, match=rf"task in environments 3, again after {MAX_RECOVERIES} attempts.*dump_"):
        run(trainer, 5)
    assert len(tries) == MAX_RECOVERIES + 1


def test_every_recovery_draws_other_actions(tmp_path):
    trainer = make_trainer(tmp_path / "run")
    act, actions, calls = trainer.algorithm.act, [], iter(range(10**9))
    trainer.algorithm.act = lambda observations: actions.append(act(observations).clone()) or actions[-1]
    spoil_term(trainer, "task", 1, when=lambda: next(calls) < 2)
    run(trainer, 1)
    assert not torch.equal(actions[0], actions[1])
    assert not torch.equal(actions[1], actions[2])


def test_the_log_has_no_iteration_twice_after_going_back(tmp_path):
    trainer, calls = make_trainer(tmp_path / "run"), iter(range(10**9))
    spoil_term(trainer, "task", 1, when=lambda: next(calls) == 3 * STEPS + 2)
    log = RunLog(tmp_path / "run")
    trainer.train(Budget(iterations=5), log.write)  # or whatever reporter `commands.train` gives
    log.close()
    assert [row["iteration"] for row in log_rows(tmp_path / "run")] == list("12345")


@pytest.mark.parametrize(
    ("moment", "ending"),
    [
        ("collecting", (signal.SIGINT,)),
        ("learning", (signal.SIGTERM, signal.SIGTERM)),
        ("learning", (signal.SIGHUP, signal.SIGHUP, signal.SIGTERM)),
    ],
)
def test_an_interrupted_iteration_leaves_nothing_behind(tmp_path, moment, ending):
    """Ctrl-C, `kill` or a closed terminal within an iteration, then resumed: the same bits as a run left alone."""
    run(make_trainer(tmp_path / "whole"), 5)
    stopped = make_trainer(tmp_path / "parts")
    owner, name, call = {
        "collecting": (stopped.env, "_simulate", 2 * STEPS + 5),
        "learning": (stopped.algorithm.optimizer, "step", 2 * 4 + 2),
    }[moment]
    function, calls = getattr(owner, name), []

    def interrupted(*args, **options):
        calls.append(name)
        if len(calls) == call:
            for number in ending:
                signal.raise_signal(number)
        return function(*args, **options)

    setattr(owner, name, interrupted)
    assert len(run(stopped, 5)) < 5
    again = make_trainer(tmp_path / "parts")
    again.load()
    run(again, 5)
    assert differing(saved_state(tmp_path / "whole"), saved_state(tmp_path / "parts")) == []


def test_signals_that_were_ignored_stay_ignored():
    """As under `nohup`, where the run must outlive its terminal."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with interruptible() as interrupted:
            signal.raise_signal(signal.SIGHUP)
            assert not interrupted()
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_second_ctrl_c_ends_at_once():
    with interruptible() as interrupted:
        signal.raise_signal(signal.SIGINT)
        assert interrupted()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
