from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field

from quadsim.config.toml import Strict, load_toml, merged, read_text


class Rotor(Strict):
    radius: Annotated[float, Field(gt=0)]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Calm(Strict):
    kind: Literal["calm"]


class Storm(Strict):
    kind: Literal["storm"]
    speed: Annotated[float, Field(ge=0, le=50)]


class Robot(Strict):
    """Every shape of key that the presets use."""

    mass: float
    rotor: Rotor | None = None
    weather: tuple[Annotated[Calm | Storm, Field(discriminator="kind")], ...] = ()


def load(tmp_path: Path, text: str) -> Robot:
    path = tmp_path / "robot.toml"
    path.write_text(text)
    return load_toml(path, "vehicles", Robot)


FULL = """
mass = 1
[rotor]
radius = 0.1
position = [0, 1, 2.5]
[[weather]]
kind = "calm"
[[weather]]
kind = "storm"
speed = 12
"""


def test_toml_becomes_a_typed_model(tmp_path):
    robot = load(tmp_path, FULL)
    assert robot.mass == 1.0
    assert robot.rotor == Rotor(radius=0.1, position=(0.0, 1.0, 2.5))
    assert robot.weather == (Calm(kind="calm"), Storm(kind="storm", speed=12.0))


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("mass = 1\nmass == 2\n", ["not valid TOML", "line 2"]),
        ("mass = " + "[" * 5000, ["not valid TOML", "recursion"]),
        ("mass = 1\nrotor = {radus = 0.1}", ['unknown key "rotor.radus"', 'did you mean "radius"']),
        ("mass = 1\nzzz = 1", ['unknown key "zzz"', "valid: mass, rotor, weather"]),
        ("mass = 1\nweather = [{kind = 'storm', sped = 1}]", ['"weather[0].sped"', '"speed"', "and 1 more"]),
        (
            "mass = 1\nweather = [{kind = 'storm', speed = 99}]",
            ["weather[0].speed = 99", "less than or equal to 50"],
        ),
        ("mass = 1\nweather = [{kind = 'rain'}]", ['weather[0].kind = "rain"; valid: calm, storm']),
        ("mass = 1\nweather = [{kind = 'strom'}]", ['weather[0].kind = "strom"; did you mean "storm"']),
        ("mass = 1\nweather = [{speed = 1}]", ['missing key "weather[0].kind"']),
        ("mass = 1\nrotor = {radius = 0}", ["rotor.radius = 0", "greater than 0"]),
        ("mass = 1\nrotor = {radius = 1, position = [1, 2]}", ["rotor.position[2]"]),
        ("mass = '1'", ['mass = "1"', "number"]),
        ("mass = inf", ["mass", "finite"]),
        ("mass = 2020-01-01", ["mass", "number"]),
        ("", ['missing key "mass"']),
    ],
)
def test_error_says_file_key_value_and_what_is_allowed(tmp_path, text, parts):
    with pytest.raises(ValueError, match=r"^[^\n]*robot\.toml[^\n]*$") as caught:
        load(tmp_path, text)
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("adis", r'unknown imu "adis"; did you mean "adis16448"\? valid: .*px4-mini'),
        ("./gone.toml", r"gone\.toml: no such file; presets: adis16448"),
        (".", "is a directory"),
        ("./binary.toml", "not a text file"),
        ("./large.toml", "at most 1 MB are allowed"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, monkeypatch, source, message):
    monkeypatch.chdir(tmp_path)
    Path("binary.toml").write_bytes(b"\xff\xfe\x00")
    Path("large.toml").write_bytes(b"#" * 1_100_000)
    with pytest.raises(ValueError, match=message):
        load_toml(Path(source) if source == "." else source, "imus", Robot)
    with pytest.raises(ValueError, match="not a plain file"):
        read_text(Path("/dev/zero"), "zero")


def test_file_in_the_working_directory_needs_its_suffix(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("robot.toml").write_bytes(b"\xef\xbb\xbfmass = 3")  # the byte-order mark is no part of the text
    assert load_toml("robot.toml", "vehicles", Robot).mass == 3.0


def test_changes_of_a_table_leave_its_other_keys():
    base = {"rotor": Rotor(radius=0.1), "mass": 1.0}
    assert merged(base, {"rotor": {"radius": 0.2}}) == {
        "rotor": {"radius": 0.2, "position": (0.0, 0.0, 0.0)},
        "mass": 1.0,
    }
