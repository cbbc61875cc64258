from __future__ import annotations

from pathlib import Path

import pytest

from proground_log.errors import ProgroundError
from recorders import registry
from recorders.registry import FORMATS, Detection, Format, detect, open_source
from tests.writers.replica import write_scene


def in_layout(folder: Path, *files: str) -> Path:
    """A folder with these files, empty."""
    for file in files:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).touch()
    return folder


LAYOUTS = {
    "tum": ("rgb.txt", "depth.txt", "groundtruth.txt", "rgb/1.png", "depth/1.png"),
    "seven-scenes": tuple(f"frame-000000.{e}" for e in ("color.png", "depth.png", "pose.txt")),
    "replica": ("traj.txt", "results/frame000000.jpg", "results/depth000000.png"),
    "replica-semantic": ("traj_w_c.txt", "rgb/rgb_0.png", "depth/depth_0.png"),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_each_layout_is_recognised_as_one_format(name: str, tmp_path: Path) -> None:
    found = detect(in_layout(tmp_path, *LAYOUTS[name]))
    assert found.format == name
    assert found.reason.startswith("has ")


@pytest.mark.parametrize("name", [name for name, each in FORMATS.items() if each.takes_source])
def test_no_format_claims_or_fails_on_what_it_is_not(name: str, tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_bytes(b"\xff\x00" * 8)
    folder = in_layout(tmp_path / "photos", "a.jpg", "b.jpg")
    long = tmp_path / ("x" * 300)
    for path in (file, folder, tmp_path / "missing", file / "below", long, tmp_path / "a\0b"):
        assert FORMATS[name].recognise(path) is None
    for other, files in LAYOUTS.items():
        if other != name:
            assert FORMATS[name].recognise(in_layout(tmp_path / other, *files)) is None


@pytest.mark.parametrize(
    ("name", "format"),
    [
        ("7scenes_redkitchen", "seven-scenes"),
        ("tum_fr1_rpy_sample/rgbd_dataset_freiburg1_rpy", "tum"),
        ("aws_small_house_labelled", "replica"),
        ("open3d_rgbd5/RGBD", "redwood"),
        ("colmap_redkitchen", "colmap"),
    ],
)
def test_real_data_are_recognised(shared_data: Path, name: str, format: str) -> None:
    if format not in FORMATS or not hasattr(
        __import__(FORMATS[format].module, fromlist=["recognise"]), "recognise"
    ):
        pytest.skip(f"no {format} yet")
    assert detect(shared_data / name).format == format


def test_auto_opens_what_was_recognised(tmp_path: Path) -> None:
    write_scene(tmp_path)
    source = open_source("auto", tmp_path)
    assert (source.name, len(source)) == ("replica", 3)
    with pytest.raises(TypeError, match="frames"):
        open_source("auto", tmp_path, frames=3)


def test_auto_needs_a_source() -> None:
    with pytest.raises(ProgroundError, match="format auto: needs a source"):
        open_source("auto")


def test_of_several_formats_none_is_taken(tmp_path: Path) -> None:
    for name in ("tum", "replica"):
        in_layout(tmp_path, *LAYOUTS[name])
    with pytest.raises(ProgroundError, match="looks like tum") as caught:
        detect(tmp_path)
    assert caught.value.where == str(tmp_path)
    assert "replica (has " in caught.value.what
    assert caught.value.todo == "say which: pglog record FORMAT SOURCE"


def test_what_nothing_recognises_is_described(tmp_path: Path) -> None:
    in_layout(tmp_path, *(f"holiday{number}.jpg" for number in range(20)))
    with pytest.raises(ProgroundError, match="is no data set that pglog knows") as caught:
        detect(tmp_path)
    assert "a folder with holiday0.jpg, holiday1.jpg, holiday10.jpg" in caught.value.what
    assert caught.value.what.endswith("and 12 more)")
    for name, each in FORMATS.items():
        assert (f"{name}: {each.description}" in caught.value.todo) == each.takes_source


def test_a_data_set_one_folder_down_is_pointed_at(tmp_path: Path) -> None:
    in_layout(tmp_path / "inner", *LAYOUTS["tum"])
    in_layout(tmp_path, "README.md")
    with pytest.raises(ProgroundError, match=r"has one in it \(a folder with README.md") as caught:
        detect(tmp_path)
    assert caught.value.todo.startswith(f"give {tmp_path / 'inner'}, which looks like tum (has ")


def test_empty_folders_files_and_nothing_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_bytes(b"12345")
    for name, message in (
        ("folder", "an empty folder"),
        ("file", "a file of 5 bytes"),
        ("nothing", "nothing: no such folder or file"),
    ):
        with pytest.raises(ProgroundError, match=message):
            detect(tmp_path / name)


def test_formats_are_asked_in_the_order_of_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def recognise(self: Format, source: Path) -> str | None:
        asked.append(self.description)
        assert source == tmp_path
        return "is asked last" if len(asked) == len(registry.FORMATS) - 1 else None

    monkeypatch.setattr(Format, "recognise", recognise)
    last = list(FORMATS)[-2]
    assert detect(tmp_path) == Detection(last, "is asked last")
    assert asked == [each.description for each in FORMATS.values() if each.takes_source]
