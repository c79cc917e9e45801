"""What the progress bar says."""

from dataclasses import replace

from modpush.training.log import TrainingBar
from tests.training.conftest import SMOKE

ROW = {"noisy/success": 0.93, "speed/steps": 250.0, "speed/updates": 120.0}
SHOWN = replace(SMOKE, progress=True)


def shown(capsys, config=SHOWN, row=ROW, **given) -> str:
    bar = TrainingBar(config)
    bar.show(row, **{"random": False, "level": "", "best": None, **given})
    bar.close()
    return capsys.readouterr().err


def test_it_says_whose_success_it_shows(capsys):
    assert "success (scripted)=0.93, steps/s=250]" in shown(capsys, random=True)
    drawn = replace(SHOWN, first_actions="random")
    assert "success (random)=0.93" in shown(capsys, drawn, random=True)
    text = shown(capsys, row={**ROW, "greedy/success": 0.5}, best=0.25)
    assert "success (policy)=0.50, best=0.250, steps/s=250, updates/s=120]" in text


def test_an_evaluation_is_named_and_does_not_count_for_the_time_left(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("tqdm.std.time", lambda: now[0])
    bar = TrainingBar(replace(SHOWN, total_steps=315))
    for _ in range(10):
        now[0] += 1.0
        bar.advance(10)
    capsys.readouterr()
    with bar.pause("evaluating 4 episodes"):
        now[0] += 1000.0
        bar.say("evaluating 3/4")
    assert "evaluating 3/4: " in capsys.readouterr().err
    now[0] += 1.0
    bar.advance(10)
    text = capsys.readouterr().err.split("\r")[-1]
    assert text.startswith(" 35%")
    assert "00:11<00:20, 10.00step/s" in text
    bar.close()
