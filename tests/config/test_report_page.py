"""The page of a configured run."""

from tests.run_files import success_table
from torchgrasp.config import describe_scenes, write_page


def test_scenes_are_told_by_their_split(composed, tmp_path):
    assert describe_scenes(composed("evaluation.split=val")) == "the val split"
    whole = composed("objects=folder", f"objects.path={tmp_path}")
    assert describe_scenes(whole) == "the object set as a whole (it has no splits)"


def test_the_options_that_matter_stand_at_its_head(composed, tmp_path):
    counts = {"wall_seconds": 60.0, "env_steps": 100, "gradient_steps": 10}
    for recipe, given in (("td3_bc", []), ("evaluate", ["policy=random"])):
        cfg = composed("seed=4", *given, recipe=recipe)
        folder = tmp_path / recipe / "first"
        folder.mkdir(parents=True)
        write_page(cfg, folder, {**success_table(8), **counts}, {})
        text = (folder / "report.html").read_text()
        assert f"{recipe} first" in text and "<td>camera</td><td>RaycastCamera</td>" in text
        assert "<td>seed</td><td>4</td>" in text
        # At the head, and in the whole configuration below; nothing was trained on in an evaluation.
        assert text.count("<td>objects.num_objects</td>") == 1 + (recipe == "td3_bc")
