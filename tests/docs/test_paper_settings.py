"""`experiment=paper` has the values that docs/departures.md tells for Sec. 6.2 to 6.4."""

import re
from typing import Any

import pytest
import yaml
from omegaconf import DictConfig, OmegaConf

from tests.configurations import ROOT, compose_config

PAGE = ROOT / "docs" / "departures.md"
HEADING = "## The paper's settings"
LEAST_ROWS = 40
ROW = re.compile(r"^\| [^|]+ \| `([\w.]+)` \| `([^`]+)` \|$", re.MULTILINE)


def read_table() -> list[tuple[str, Any]]:
    """Option and value of every row below the heading, up to the next one."""
    section = PAGE.read_text().partition(f"\n{HEADING}\n")[2].partition("\n## ")[0]
    return [(option, yaml.safe_load(value)) for option, value in ROW.findall(section)]


@pytest.fixture(scope="module")
def paper() -> DictConfig:
    return compose_config("experiment=paper")


def test_the_page_has_its_table():
    rows = read_table()
    assert len(rows) >= LEAST_ROWS, f"{PAGE} has {len(rows)} rows below {HEADING!r}"
    assert len({option for option, _ in rows}) == len(rows)
    assert {"transforms.aggregate.carve", "model.width", "online.policy_delay"} <= {name for name, _ in rows}


@pytest.mark.parametrize(("option", "value"), read_table())
def test_an_option_has_the_papers_value(paper, option, value):
    parent, _, name = option.rpartition(".")
    node = OmegaConf.select(paper, parent) if parent else paper
    assert name in node, f"{option} is no option"
    found = node[name]
    found = OmegaConf.to_container(found, resolve=True) if OmegaConf.is_config(found) else found
    if isinstance(value, float) or (isinstance(value, list) and any(isinstance(v, float) for v in value)):
        assert found == pytest.approx(value, rel=1e-3)
    else:
        assert found == value and type(found) is type(value)
