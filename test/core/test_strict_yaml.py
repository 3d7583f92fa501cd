"""The strict loader: YAML 1.2 numbers in, one clear error for everything doubtful."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hd_control.core.errors import ConfigError
from hd_control.core.strict_yaml import expect_keys, load_params_file, load_yaml, parse_yaml


def test_numbers_follow_yaml_1_2():
    text = "a: 1e-3\nb: 1.0e-3\nc: 1E3\nd: .5\ne: -7\nf: true\ng: ~\nh: '1e-3'\non: fine\n"
    assert parse_yaml(text) == {
        "a": 1e-3, "b": 1e-3, "c": 1000.0, "d": 0.5, "e": -7, "f": True, "g": None, "h": "1e-3", "on": "fine",
    }  # fmt: skip
    assert isinstance(parse_yaml("a: -7")["a"], int)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: 1\nb: 2\na: 3", "line 3: duplicate key 'a', first on line 1"),
        ("a: on", "ambiguous"),
        ("a: 010", "ambiguous"),
        ("a: 1:30", "ambiguous"),
        ("a: 0x1F", "ambiguous"),
        ("a: .nan", "finite"),
        ("a: -.Inf", "finite"),
        ("a: 1e999", "finite"),
        ("a: &x 1\nb: *x", "anchors"),
        ("a: !!python/object:os.system x", "tag"),
        ("<<: {a: 1}", "merge"),
        ("[1]: 2", "key must be text"),
        ("a: 1\n---\nb: 2", "more than one document"),
        ("a: [1, 2", "line"),
        ("[" * 40 + "]" * 40, "levels"),
        ("[" + "1," * 60_000 + "1]", "values"),
    ],
)
def test_f26_doubtful_text_is_refused_with_its_line(text, says):
    with pytest.raises(ConfigError, match=f"HD-F26 yaml_bad file.yaml.*{says}"):
        parse_yaml(text, "file.yaml")


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.binary(max_size=200))
def test_any_bytes_give_a_value_or_one_error(data):
    try:
        parse_yaml(data)
    except ConfigError as error:
        assert "\n" not in str(error) or len(str(error)) < 400


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.dictionaries(st.from_regex(r"[a-z]{1,8}", fullmatch=True), st.floats(allow_nan=False, allow_infinity=False)))
def test_finite_numbers_round_trip(table):
    assert parse_yaml("\n".join(f"k{name}: {value!r}" for name, value in table.items()) or "{}") == {
        f"k{name}": value for name, value in table.items()
    }


def test_unknown_key_names_the_nearest(tmp_path):
    table = parse_yaml("gear_ratio: 100\nstifness: 2")
    with pytest.raises(ConfigError, match=r"line 2: unknown key 'stifness', did you mean 'stiffness'\?"):
        expect_keys(table, "drive.yaml", ["gear_ratio"], ["stiffness"])
    with pytest.raises(ConfigError, match="missing key 'mass'"):
        expect_keys(table, "drive.yaml", ["gear_ratio", "mass"], ["stifness"])


def test_params_file_sections_overlay(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text("/**:\n  ros__parameters:\n    a: 1\n    b: {c: 2}\nnode:\n  ros__parameters:\n    a: 3\n")
    assert load_params_file(path, "node") == {"a": 3, "b.c": 2}
    assert load_params_file(path, "other") == {"a": 1, "b.c": 2}
    path.write_text("other:\n  ros__parameters: {}\n")
    with pytest.raises(ConfigError, match=r"no section for node; there is other; use '/\*\*:'"):
        load_params_file(path, "node")


def test_missing_and_huge_files(tmp_path):
    with pytest.raises(ConfigError, match="cannot read"):
        load_yaml(tmp_path / "absent.yaml")
    big = tmp_path / "big.yaml"
    big.write_text("a: " + "x" * 1_000_001)
    with pytest.raises(ConfigError, match="larger"):
        load_yaml(big)
