"""`hd challenge`: a folder with something hidden, answers scored against the seal, a campaign that can be stopped."""

import json

import pytest

from hd_control.cli import challenge
from hd_control.cli.main import main
from hd_sim.truth import open_seal


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "puzzle"
    options = ["--seed", "12", "--effect", "gauge_offset:2", "--motion", "short", "-o", str(path), "--quiet"]
    assert main(["challenge", "new", *options]) == 0
    return path


def _diagnosis(tmp_path, *names, verdict="missing"):
    effects = [{"name": name, "confidence": 0.9, "parameters": {}, "confusable_with": []} for name in names]
    joint = {"verdict": verdict, "effects": effects, "unknown": None, "experiments": []}
    file = tmp_path / "diagnosis.json"
    file.write_text(json.dumps({"schema": "hd.diagnosis/1", "joints": {"joint_1": joint}}))
    return str(file)


def test_a_new_challenge_is_complete_and_repeats(folder, tmp_path):
    names = {path.name for path in folder.iterdir()}
    assert names == {"fit", "held_out", "model.yaml", "robot.urdf", "truth.seal", "README.txt"}
    again = tmp_path / "again"
    options = ["--seed", "12", "--effect", "gauge_offset:2", "--motion", "short", "-o", str(again), "--quiet"]
    assert main(["challenge", "new", *options]) == 0
    for path in ("fit/fit_0.mcap", "held_out/held_out_0.mcap", "robot.urdf", "truth.seal", "README.txt"):
        assert (folder / path).read_bytes() == (again / path).read_bytes(), path


def test_force_replaces_a_challenge_and_nothing_else(folder, tmp_path, capsys):
    words = ["challenge", "new", "--seed", "13", "--motion", "short", "--force", "--quiet", "-o"]
    before = (folder / "truth.seal").read_bytes()
    assert main([*words, str(folder)]) == 0
    assert (folder / "truth.seal").read_bytes() != before
    (tmp_path / "work").mkdir()
    assert main([*words, str(tmp_path / "work")]) == 2
    assert "is no challenge" in capsys.readouterr().err and (tmp_path / "work").is_dir()


def test_nothing_outside_the_seal_gives_the_answer_away(folder):
    for path in folder.rglob("*"):
        if path.is_file():
            assert b"gauge_offset" not in path.read_bytes(), path


def test_a_right_answer_and_a_wrong_one(folder, tmp_path, capsys):
    assert main(["challenge", "check", str(folder), _diagnosis(tmp_path, "gauge_offset")]) == 0
    assert "joint_1: right; hidden: gauge_offset" in capsys.readouterr().out
    assert main(["challenge", "check", str(folder), _diagnosis(tmp_path, "payload"), "--json", "-"]) == 1
    out = json.loads(capsys.readouterr().out)
    assert out["right"] is False and out["joints"]["joint_1"]["wrong"] == ["payload"]


def test_on_a_poor_recording_a_refusal_is_right(folder, tmp_path, capsys):
    assert main(["challenge", "check", str(folder), _diagnosis(tmp_path, verdict="cannot_tell")]) == 0
    assert "refused" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("nonsense", "not JSON"),
        ("[]", "not a diagnosis"),
        ('{"schema": "hd.compare/1", "joints": {}}', "schema"),
        ('{"schema": "hd.diagnosis/1", "joints": {}}', "says nothing of joint_1"),
        ('{"schema": "hd.diagnosis/1", "joints": {"joint_1": {}}}', "not in the form"),
        (
            '{"schema": "hd.diagnosis/1", "joints": {"joint_1": {"verdict": "missing", "effects": [1]}}}',
            "not in the form",
        ),
    ],
)
def test_a_file_that_is_no_diagnosis_is_one_line(folder, tmp_path, capsys, content, says):
    file = tmp_path / "bad.json"
    file.write_text(content)
    assert main(["challenge", "check", str(folder), str(file)]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1


def test_bad_input_is_one_line_and_leaves_nothing(folder, tmp_path, capsys):
    for words, says in (
        (["new", "-o", str(folder)], "exists"),
        (["new", "-o", str(tmp_path / "x"), "--effect", "gremlins"], "unknown effect"),
        (["new", "-o", str(tmp_path / "x"), "--effect", "backlash:much"], "not a number"),
        (["new", "-o", str(tmp_path / "x"), "--motion", "dance"], "--motion"),
        (["new", "-o", str(tmp_path / "no" / "x"), "--motion", "short"], "no"),
        (["check", str(tmp_path), _diagnosis(tmp_path)], "seal"),
        (["check", str(folder), str(tmp_path / "none.json")], "none.json"),
        (["campaign", "--seed", "1", "--n", "0"], "--n"),
        (["campaign"], "--seed"),
        (["dance"], "dance"),
    ):
        assert main(["challenge", *words]) == 2, words
        error = capsys.readouterr().err
        assert says in error and error.count("\n") == 1, (words, error)
    assert not (tmp_path / "x").exists() and not list(tmp_path.glob(".*partial"))


def test_a_campaign_prints_its_table_and_goes_on_from_its_record(tmp_path, capsys, monkeypatch):
    def refuse(question):
        return {"verdict": "cannot_tell", "effects": [], "unknown": None, "experiments": []}

    monkeypatch.setattr("hd_sim.puzzles.campaign.ask", refuse)
    record = tmp_path / "record.jsonl"
    words = ["campaign", "--seed", "5", "--n", "4", "--kind", "poor", "--record", str(record)]
    assert main(["challenge", *words]) == 0
    assert "| poor recording: refused | 4/4 | 100.0 % | 39.8–100.0 % |" in capsys.readouterr().out
    assert main(["challenge", *words, "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["seeds"] == [5, 6, 7, 8] and len(record.read_text().splitlines()) == 5


def test_an_interrupted_campaign_prints_what_it_has(tmp_path, capsys, monkeypatch):
    asked = []

    def interrupted(question):
        if len(asked) == 2:
            raise KeyboardInterrupt
        asked.append(question)
        return {"verdict": "adequate", "effects": [], "unknown": None, "experiments": []}

    monkeypatch.setattr("hd_sim.puzzles.campaign.ask", interrupted)
    words = ["campaign", "--seed", "5", "--n", "4", "--kind", "none", "--record", str(tmp_path / "r.jsonl")]
    assert main(["challenge", *words]) == 130
    out = capsys.readouterr().out
    assert "no effect: false alarm | 0/2" in out and "interrupted after 2 of 4" in out


def test_an_arm_challenge_seals_every_joint(tmp_path, monkeypatch):
    monkeypatch.setattr("hd_sim.puzzles.arm_recordings.FIT_S", 21.0)
    monkeypatch.setattr("hd_sim.puzzles.arm_recordings.HELD_OUT_S", 20.0)
    assert main(["challenge", "new", "--arm", "--seed", "3", "-o", str(tmp_path / "arm"), "--quiet"]) == 0
    assert len(open_seal(tmp_path / "arm" / "truth.seal")["joints"]) == 7
    assert challenge.NAME == "challenge"


def test_a_challenge_of_the_second_world(tmp_path, capsys):
    path = tmp_path / "second"
    options = ["--world", "second", "--seed", "3", "--effect", "gauge_gain:2", "-o", str(path), "--quiet"]
    assert main(["challenge", "new", *options]) == 0
    joint = open_seal(path / "truth.seal")["joints"]["joint_1"]
    assert joint["names"] == ["gauge_gain"] and joint["visibility"]["gauge_gain"] > 0.0
    outside = [file for file in path.rglob("*") if file.is_file() and file.name != "truth.seal"]
    assert outside and not [file for file in outside if b"gauge_gain" in file.read_bytes()]
    assert main(["challenge", "check", str(path), _diagnosis(tmp_path, "gauge_gain", "presliding")]) == 0
    wrong = ["challenge", "new", "--world", "second", "--motion", "slow_only", "-o", str(tmp_path / "x")]
    assert main(wrong) == 2 and "expected one of general, sine" in capsys.readouterr().err


def test_a_campaign_of_both_worlds_sets_them_side_by_side(tmp_path, capsys, monkeypatch):
    from hd_sim.puzzles import campaign

    answer = {"verdict": "adequate", "effects": [], "unknown": None, "experiments": []}
    monkeypatch.setattr(campaign, "ask", lambda question: answer)
    log = tmp_path / "looks.jsonl"
    words = ["challenge", "campaign", "--n", "2", "--seed", "900000", "--kind", "none", "--log", str(log)]
    assert main([*words, "--json", str(tmp_path / "out.json")]) == 0
    text, document = capsys.readouterr().out, json.loads((tmp_path / "out.json").read_text())
    assert "| figure | home | second | worse | target |" in text and "seeds 900000 to 900001: test" in text
    worlds = document["headline"][0]["worlds"]
    assert {world: row["count"] for world, row in worlds.items()} == {"home": 1, "second": 1}
    assert json.loads(log.read_text())["count"] == 2
    assert main(words) == 2 and "were looked at" in capsys.readouterr().err
