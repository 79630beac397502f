"""Files and folders as users have them, sorted into model, sky and frames."""

import pytest
from playwright.sync_api import expect
from watching import drop


@pytest.fixture
def sort(server, open_page):
    """The page's own sorting: paths in, names out."""
    page = open_page(server.url)

    def run(*paths: str) -> dict:
        return page.evaluate(
            """async (paths) => {
              const { sort } = await import("/static/js/intake.js");
              const files = paths.map((path) => Object.assign(new File(["x"], path.split("/").at(-1)), { path }));
              const found = sort(files), names = (list) => list.map((file) => file.path);
              const { model, sky, frames, truth, ignored } = found;
              return { model: names(model), sky: names(sky), frames: names(frames), truth: truth?.path, ignored };
            }""",
            list(paths),
        )

    return run


def test_a_folder_of_the_simulator(sort):
    found = sort("p/case.json", "p/demo.glb", "p/background/0.png", "p/frames/10.png", "p/frames/9.png", "p/truth.csv")
    assert found == {
        "model": ["p/demo.glb"],
        "sky": ["p/background/0.png"],
        "frames": ["p/frames/9.png", "p/frames/10.png"],  # by number, not by letter
        "truth": "p/truth.csv",
        "ignored": 1,
    }


def test_names_that_only_resemble(sort):
    found = sort("skylab/skylab_1.fits", "skylab/skylab_2.fits.gz", "skylab/dark_01.fits", "skylab/.DS_Store")
    assert found["frames"] == ["skylab/skylab_1.fits", "skylab/skylab_2.fits.gz"]
    assert found["sky"] == ["skylab/dark_01.fits"]
    assert sort("a dark night/1.png")["frames"] == ["a dark night/1.png"]
    assert sort("n/Darks/1.png", "n/2.png")["sky"] == ["n/Darks/1.png"]


def test_the_largest_folder_is_the_pass(sort):
    found = sort("p/mask/1.png", "p/frames/1.png", "p/frames/2.png", "p/preview.jpg")
    assert (found["frames"], found["ignored"]) == (["p/frames/1.png", "p/frames/2.png"], 2)


def test_a_robot_brings_its_meshes(sort):
    assert sort("s/wing.stl", "s/body.stl", "s/sat.urdf")["model"] == ["s/sat.urdf", "s/body.stl", "s/wing.stl"]
    assert sort("s/a.stl", "s/b.stl")["model"] == ["s/a.stl"]


def test_a_folder_is_dropped_on_the_page(server, open_page, tmp_path):
    """A real drop of a real folder, with more files than the browser gives at a time."""
    for folder, count in (("sky", 1), ("frames", 120)):
        (tmp_path / "pass" / folder).mkdir(parents=True)
        for n in range(count):
            (tmp_path / "pass" / folder / f"{n}.png").write_bytes(b"x")
    page = open_page(server.url)
    expect(page.locator("#link .text")).not_to_have_text("connecting")
    drop(page, tmp_path / "pass")
    expect(page.get_by_role("dialog", name="New track")).to_be_visible()
    expect(page.locator(".frame-facts")).to_have_text("120 files, 0.png to 119.png")
    expect(page.locator(".sky-facts")).to_have_text("pass/sky/0.png")
    expect(page.get_by_label("Name")).to_have_value("pass")
