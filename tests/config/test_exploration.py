"""Who explores and disturbs: refused where it cannot be called."""

import pytest

from torchgrasp.config.exploration import check_demonstrators, check_exploration, make_demonstrator
from torchgrasp.errors import ConfigError
from torchgrasp.planning import Disturb, ExpertPolicy


@pytest.mark.parametrize(
    ("kind", "chance"), [("expert", None), ("perturbed", 0.3), ("failed", 0.7), ("learner", None)]
)
def test_the_expert_is_disturbed_as_its_kind_asks_for(composed, kind, chance):
    expert, *others = make_demonstrator(composed("experiment=smoke"), kind).module
    assert isinstance(expert, ExpertPolicy) and expert.execute
    assert [type(each) for each in others] == ([] if chance is None else [Disturb])
    assert [each.probability for each in others] == ([] if chance is None else [chance])


@pytest.mark.parametrize(
    ("name", "value", "way"),
    [
        ("noise", "null", "with the same end switches it off"),
        ("expert_start", "null", "probability=0 switches it off, or do without"),
        ("expert_start", "0.3", "probability=0 switches it off, or do without"),
    ],
)
def test_what_cannot_be_called_is_named_with_its_reader_and_the_way_out(composed, name, value, way):
    cfg = composed(f"collector.{name}={value}")
    told = f"^collector.{name}=.* with the run: configure it .*"
    other = "or do without" if "or do without" in way else None
    with pytest.raises(ConfigError, match=told) as raised:
        check_exploration(cfg, name, "the run", other)
    assert way.split(",")[0] in str(raised.value) and str(raised.value).endswith(f"{other or 'off)'}.")
    check_exploration(composed("experiment=laptop"), name, "the run")


def test_a_learner_needs_expert_starts_where_they_are_asked_for(composed):
    given = ["demonstrations.kind=learner", "collector.expert_start=null"]
    check_demonstrators(composed(*given))
    with pytest.raises(ConfigError, match=r"leave demonstrations\.expert_start out"):
        check_demonstrators(composed(*given, "demonstrations.expert_start=true"))
