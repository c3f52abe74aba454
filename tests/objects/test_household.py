import numpy as np
import pytest
import trimesh

from tests.configurations import compose_config
from torchgrasp.config.environments import make_objects
from torchgrasp.errors import ConfigError
from torchgrasp.objects import MixtureObjects, ProceduralObjects
from torchgrasp.objects.build import graspable_at_rest
from torchgrasp.objects.families import FAMILIES, HELD_OUT, TRAINED
from torchgrasp.objects.household import HOUSEHOLD
from torchgrasp.objects.lofts import Section, loft
from torchgrasp.objects.prisms import star, strip
from torchgrasp.objects.profiles import bands, turned
from torchgrasp.objects.solids import hull, mass_properties
from torchgrasp.objects.surface import depth_in_parts, sample_surface

# Of the usual test set's first ten draws: vertices, parts, and the sum of all coordinates' sizes. Published
# figures rest on these shapes: let nothing change them.
AS_EVER = {
    "box-test-00000": (8, 1, 2.307625267),
    "cylinder-test-00000": (98, 1, 18.406302081),
    "capsule-test-00000": (962, 3, 68.977158835),
    "bottle-test-00000": (194, 3, 48.801977329),
    "bowl-test-00000": (290, 29, 47.198680103),
    "mug-test-00000": (264, 19, 52.823883242),
    "ellipsoid-test-00000": (1106, 4, 84.590009741),
    "bracket-test-00000": (16, 2, 3.486185444),
    "hammer-test-00000": (106, 2, 15.711643905),
    "dumbbell-test-00000": (290, 3, 30.436892392),
}


def first_draws(objects):
    """Name and solid of what the set tries first for each of its objects."""
    for index, name in enumerate(objects.names):
        rng = np.random.default_rng(np.random.SeedSequence((*objects._entropy(index), 0)))
        yield name, {**FAMILIES, **HOUSEHOLD}[name.split("-")[0]](rng)


def test_the_usual_sets_are_what_they_always_were():
    assert ProceduralObjects("train").families == ProceduralObjects("val").families == tuple(TRAINED)
    drawn = {}
    for name, solid in first_draws(ProceduralObjects("test", num_objects=10)):
        coordinates = np.concatenate((solid.vertices, *solid.parts))
        drawn[name] = (len(solid.vertices), len(solid.parts), pytest.approx(np.abs(coordinates).sum()))
    assert drawn == AS_EVER


@pytest.mark.parametrize("family", HOUSEHOLD)
def test_every_family_is_closed_and_made_of_small_convex_parts_that_stand_for_it(family):
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        solid = HOUSEHOLD[family](rng)
        pieces = trimesh.Trimesh(solid.vertices, solid.faces).split(only_watertight=True)
        assert sum(len(piece.faces) for piece in pieces) == len(solid.faces)
        assert all(piece.is_winding_consistent and piece.volume > 0 for piece in pieces)
        assert all(4 <= len(part) <= 64 and ptp_across(part) > 0.001 for part in solid.parts)
        seen, _ = sample_surface(solid.vertices, solid.faces, 1500, rng)
        assert depth_in_parts(seen, solid.parts).min() > -0.001
        part = int(rng.integers(len(solid.parts)))
        felt, _ = sample_surface(*hull(solid.parts[part]), 30, rng)
        others = solid.parts[:part] + solid.parts[part + 1 :]
        felt = felt[depth_in_parts(felt, others) < -2e-4] if others else felt
        if len(felt):
            mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
            assert trimesh.proximity.closest_point_naive(mesh, felt)[1].max() < 0.001


def ptp_across(part):
    """Extent of a part where it is thinnest."""
    return np.ptp(part @ np.linalg.svd(part - part.mean(0))[2][2])


@pytest.mark.parametrize("family", HOUSEHOLD)
def test_sizes_are_those_of_a_household(family):
    for seed in range(20):
        solid = HOUSEHOLD[family](np.random.default_rng(seed))
        assert 0.04 < np.ptp(solid.vertices, axis=0).max() < 0.31


@pytest.fixture(scope="module")
def one_of_each(tmp_path_factory):
    cache = tmp_path_factory.mktemp("household")
    families = [*HOUSEHOLD]
    return ProceduralObjects(
        "val", families=families, num_objects=len(families), num_grasps=100, cache_dir=cache
    )


# Building takes half a second: one of each kind of construction here, the others among the slow tests.
_BUILT = ("flat_bottle", "wide_box", "thin_bowl", "turned", "star", "scissors", "compound")
_SLOW = [pytest.param(family, marks=pytest.mark.slow) for family in HOUSEHOLD if family not in _BUILT]


@pytest.mark.parametrize("family", [*_BUILT, *_SLOW])
def test_every_family_can_be_grasped_where_it_rests(one_of_each, family):
    item = one_of_each[[*HOUSEHOLD].index(family)]
    assert item.family == family and len(item.grasps) == 100
    assert graspable_at_rest(item) > 0.1
    assert np.abs(mass_properties([part.astype(np.float64) for part in item.parts])[1]).max() < 1e-6


def test_splits_and_seeds_share_no_shape():
    shapes = [
        solid.vertices[:8].tobytes()
        for split in ("train", "val", "test")
        for seed in (0, 1)
        for _, solid in first_draws(
            ProceduralObjects(split, families=[*HOUSEHOLD], num_objects=40, seed=seed)
        )
    ]
    assert len(set(shapes)) == len(shapes) == 240


def test_names_of_both_kinds_may_be_mixed_in_every_split():
    for split in ("train", "val", "test"):
        names = ProceduralObjects(split, families=["pan", "box"], num_objects=3).names
        assert names == (f"pan-{split}-00000", f"box-{split}-00000", f"pan-{split}-00001")
    with pytest.raises(ConfigError, match=r"'teapot': choose from box, .*thin_mug"):
        ProceduralObjects("train", families=["teapot"])


@pytest.mark.pybullet
def test_the_configured_set_holds_every_family_and_the_mixture_half_of_them():
    cfg = compose_config("policy=random", "objects=household", recipe="evaluate")
    cfg.evaluation.num_objects = 52
    objects = make_objects(cfg, "test")
    assert isinstance(objects, ProceduralObjects) and len(objects) == 52
    assert objects.families == tuple(HOUSEHOLD) and not {*HOUSEHOLD} & {*TRAINED, *HELD_OUT}
    varied = make_objects(compose_config("objects=varied", "objects.num_objects=9"), "train")
    assert isinstance(varied, MixtureObjects)
    rng = np.random.default_rng(0)
    drawn = [varied.names[varied.draw(rng)].split("/")[0] for _ in range(400)]
    shares = [drawn.count(name) / 400 for name in ("procedural", "household", "random_urdfs")]
    assert shares == pytest.approx((0.25, 0.5, 0.25), abs=0.06)


@pytest.mark.pybullet
@pytest.mark.parametrize(
    ("given", "numbers"),
    [
        ([], (320, 320, 320)),
        (["objects.sets.household.num_objects=1500"], (320, 1500, 320)),
        (["objects.num_objects=9"], (9, 9, 9)),
    ],
)
def test_each_set_of_a_mixture_has_its_own_number_unless_all_are_given_one(given, numbers):
    varied = make_objects(compose_config("objects=varied", *given), "train")
    members = [name.split("/")[0] for name in varied.names]
    assert tuple(members.count(name) for name in ("procedural", "household", "random_urdfs")) == numbers


def test_a_loft_between_circles_is_a_cone_by_hand():
    cone = loft([Section(0.0, (0.02, 0.02)), Section(0.06, (0.01, 0.01))])
    volume, centre = mass_properties(cone.parts)
    assert volume == pytest.approx(np.pi * 0.06 / 3 * (4e-4 + 2e-4 + 1e-4), rel=3e-3)
    assert centre == pytest.approx((0.0, 0.0, 0.06 * (4 + 2 * 2 + 3) / (4 * (4 + 2 + 1))), abs=1e-5)


def test_superellipses_pass_through_the_points_that_their_equation_gives():
    section = Section(0.01, (0.05, 0.03), 4.0, (0.01, 0.0))
    corners = (section.support(section.normals(64))[:, :2] - (0.01, 0.0)) / (0.05, 0.03)
    assert (corners**4).sum(1) == pytest.approx(np.ones(64))


def test_a_strip_keeps_its_width_around_a_corner():
    bar = strip(np.array(((0.1, 0.0), (0.0, 0.0), (0.0, 0.1))), 0.02, 0.03)
    # An L of two arms of 10 cm about the middle line: 2 x 0.02 x 0.1 square metres.
    assert sum(mass_properties([part])[0] for part in bar.parts) == pytest.approx(0.004 * 0.03)


def test_a_cross_of_five_squares():
    cross = star(np.arange(4) * np.pi / 2, 0.01 * np.sqrt(2), [0.02] * 4, 1.0, 0.01)
    assert mass_properties(cross.parts)[0] == pytest.approx(5 * 0.02**2 * 0.01)
    assert np.ptp(cross.vertices, axis=0) == pytest.approx((0.06, 0.06, 0.01))


def test_bands_follow_a_profile_with_a_step():
    profile = [(0.02, 0.0), (0.02, 0.03), (0.005, 0.03), (0.005, 0.08), (0.0, 0.085)]
    assert [*bands(profile)] == [profile[:2], profile[2:]]
    assert mass_properties(turned(profile).parts)[0] == pytest.approx(
        np.pi * (4e-4 * 0.03 + 2.5e-5 * (0.05 + 0.005 / 3)), rel=0.01
    )


@pytest.mark.parametrize("families", ["box", 5, {"box": 1}])
def test_families_that_are_no_list_are_refused(families):
    with pytest.raises(ConfigError, match=r"families=.*: give a list of names"):
        ProceduralObjects("train", families=families)
