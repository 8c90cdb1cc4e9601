"""Design values of fabric, cables and steel bars: by hand, from tables, and bad input."""

from __future__ import annotations

from typing import Any

import pytest
from cabled_square import sheet
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, InputError, IsotropicMembrane, Solver, codes

FOIL = IsotropicMembrane(E=900.0, nu=0.3, thickness=1.0, prestress=3.0)
FABRIC: dict[str, Any] = {
    "strength": (84.0, 80.0),
    "gamma_M": {"ULS": 1.4, "accidental": 1.1},
    "biaxial": 1.2,
    "ageing": 1.1,
    "duration": {"permanent": 1.7, "weight": 1.7, "snow": 1.5, "wind": 1.0},
    "temperature": {"permanent": 1.1, "weight": 1.1, "snow": 1.0, "wind": 1.05},
    "size": 1.1,
}
COMMON = 1.4 * 1.2 * 1.1 * 1.1
"""gamma_M k_biax k_age k_size."""


@pytest.mark.parametrize(
    ("loads", "further"),
    [
        ([], 1.7 * 1.1),  # prestress alone
        (["weight"], 1.7 * 1.1),
        (["weight", "snow"], 1.5 * 1.0),
        (["weight", "snow drifted"], 1.5 * 1.0),  # by its kind
        (["wind x"], 1.0 * 1.05),
        # both lead: the wind is the shortest, and with snow it is cold
        (["weight", "snow", "wind x"], 1.0 * 1.0),
    ],
)
def test_factors_multiply(loads: list[str], further: float) -> None:
    """By hand; not compared with a source."""
    found = codes.FabricDesign(**FABRIC).of("ULS", loads)
    assert found.divisor == pytest.approx(COMMON * further)
    assert found.design == pytest.approx((84.0 / COMMON / further, 80.0 / COMMON / further))


@pytest.mark.parametrize(
    ("loads", "k_long", "k_temp"),
    [
        # the wind leads: a gust, in the cold, whatever lies on the roof
        ({"weight": 1.35, "wind x": 1.5, "snow": 0.75}, 1.0, 1.0),
        # the snow leads, and a smaller wind beside it shortens nothing
        ({"weight": 1.35, "snow": 1.5, "wind x": 0.9}, 1.5, 1.0),
        ({"weight": 1.2, "wind": 1.0, "snow": 0.3}, 1.0, 1.0),  # ASCE 7-22: the weight is more
        ({"weight": 1.35, "snow": 1.5, "wind": -1.5}, 1.0, 1.0),  # equals; uplift
        ({"weight": 1.0, "temperature summer": 1.5}, 1.3, 1.2),  # hot, by its own factor
        ({"wind": 1.5, "temperature summer": 0.9}, 1.0, 1.2),
        ({"wind": 1.5, "temperature winter": 0.9}, 1.0, 1.0),
        ({"weight": 1.35, "storage": 1.5}, 1.9, 1.0),  # longer than what is permanent
    ],
)
def test_the_leading_load_decides(loads: dict[str, float], k_long: float, k_temp: float) -> None:
    """By hand; not compared with a source for membranes."""
    fabric = codes.FabricDesign(
        (84.0, 80.0), gamma_M=1.4,
        duration={"permanent": 1.7, "weight": 1.7, "snow": 1.5, "temperature": 1.3, "wind": 1.0,
                  "storage": 1.9},
        temperature={"permanent": 1.1, "weight": 1.1, "snow": 1.0, "wind": 1.05, "storage": 1.0,
                     "temperature summer": 1.2, "temperature winter": 1.0},
    )  # fmt: skip
    found = fabric.of("ULS", loads)
    assert (found.factors["k_long"], found.factors["k_temp"]) == (k_long, k_temp)
    assert found.divisor == pytest.approx(1.4 * k_long * k_temp)


def test_durations_that_no_combination_judges(comm: MPI.Intracomm) -> None:
    """Snow only beside a leading wind, and no state without short loads; all in a full table."""
    scene = sheet(comm, 4, material=FOIL, side=4.0)
    for name in ("weight", "snow", "wind"):
        scene.put_load((0.0, 0.0, -0.1), name=name)
    scene.set_strengths(
        codes.FabricDesign(
            (84.0, 80.0), gamma_M=1.4,
            duration={"permanent": 1.7, "weight": 1.7, "snow": 1.5, "wind": 1.0},
        )
    )  # fmt: skip
    solver = Solver(scene)
    solver.advance()
    storm = {"storm": {"weight": 1.0, "wind": 1.5, "snow": 0.75}}
    table = solver.judge(solver.combine(storm))
    assert table.unjudged == tuple(
        f"fabric under {load!r} for its k_long = {k}"
        for load, k in (("permanent", 1.7), ("weight", 1.7), ("snow", 1.5))
    )
    assert "not judged: fabric under 'permanent'" in repr(table)
    snow = {"snow": {"weight": 1.0, "snow": 1.5, "wind": 0.9}}
    assert "snow" not in "".join(solver.judge(solver.combine(storm | snow)).unjudged)
    full = codes.combinations(codes.en1990, ["weight"], ["snow", "wind"])
    found = solver.combine(full)
    judged = solver.judge(found)
    assert not judged.unjudged
    # by hand: the fabric under snow, of the larger factors
    solver.restore(found["ULS: 1.35 weight + 1.5 snow + 0.9 wind"].snapshot)
    design = solver.summary().design[""]
    assert design.design[0] == pytest.approx(84.0 / (1.4 * 1.5))
    assert design.durations == {"permanent": 1.7, "weight": 1.7, "snow": 1.5, "wind": 1.0}


def test_the_partial_factor_of_each_limit_state() -> None:
    fabric = codes.FabricDesign(**FABRIC)
    assert fabric.of("accidental", []).factors["gamma_M"] == 1.1
    assert fabric.of("ULS 6.10a/b", []).factors["gamma_M"] == 1.4
    with pytest.raises(InputError, match=r"no partial factor gamma_M .*'erection'"):
        fabric.of("erection", [])


def test_the_table_has_every_factor() -> None:
    table = codes.combinations(
        codes.en1990, ["weight"], ["snow", "wind"], state=["ULS", "characteristic"]
    )
    text = codes.FabricDesign(**FABRIC).table(table).splitlines()
    assert len(text) == 1 + sum(name.startswith("ULS") for name in table)
    assert text[0].split() == "gamma_M k_biax k_age k_long k_temp k_size warp weft".split()
    row = next(one for one in text if "1.35 weight + 1.5 snow  " in one).split()[-8:]
    found = [float(one) for one in row]
    assert found[:6] == [1.4, 1.2, 1.1, 1.5, 1.0, 1.1]
    assert found[6] == pytest.approx(84.0 / (COMMON * 1.5), rel=1e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"strength": 84.0}, "strength = 84.0; pass two"),
        ({"strength": (84.0, 0.0)}, "strength"),
        ({"biaxial": 0.8}, "biaxial = 0.8 is below 1; factors divide strengths: pass 1.25"),
        ({"gamma_M": {"SLS": 1.0}}, "limit state of gamma_M"),
        ({"duration": {"snow": 1.5}}, 'lacks "permanent"'),
        ({"temperature": 1.1}, "temperature = 1.1"),
        ({"size": float("nan")}, "size"),
    ],
)
def test_bad_factors(change: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        codes.FabricDesign(**FABRIC | change)


def test_two_factors_of_one_load() -> None:
    both = {"permanent": 1.7, "snow": 1.5, "snow drifted": 1.3}
    fabric = codes.FabricDesign((84.0, 80.0), gamma_M=1.4, duration=both)
    assert fabric.of("ULS", ["snow"]).factors["k_long"] == 1.5
    with pytest.raises(InputError, match="'snow' and 'snow drifted' are two duration factors"):
        fabric.of("ULS", ["snow drifted"])


def test_combinations_without_their_design_strength(comm: MPI.Intracomm) -> None:
    """Refused by name before anything is computed, and strengths in other units."""
    scene = sheet(comm, 4, material=FOIL, side=4.0)
    for name in ("snow", "sand"):
        scene.put_load((0.0, 0.0, -0.1), name=name)
    scene.set_strengths(codes.FabricDesign(**FABRIC))
    solver = Solver(scene)
    for one, words in (
        ({"sand": 1.5}, "combine: 'bad': the fabric has no duration factor of the load 'sand'"),
        ({"snow": 1.5, "state": "erection"}, "combine: 'bad': .*gamma_M .*'erection'"),
        ({"state": "SLS"}, "'bad': state = 'SLS'"),
        ({"prestress": 0.0}, "'bad': prestress = 0.0"),
        ({"without": ["A9"]}, "no cable or bar 'A9'"),
        ({"without": "A9"}, "'bad': without = 'A9'"),
    ):
        with pytest.raises(InputError, match=words):
            solver.combine({"good": {"snow": 1.0}, "bad": one})
    assert not solver.steps
    found = solver.combine({"service": {"sand": 1.0, "state": "frequent"}})
    assert found["service"].state == "frequent"
    per_5_cm = codes.FabricDesign((4200.0, 4000.0), gamma_M=1.4)
    with pytest.raises(InputError, match=r"strain of 4; .*84 kN/m is 4200 N per 5 cm"):
        scene.set_strengths(per_5_cm)
    assert scene.membrane.strengths[""].strength == (84.0, 80.0)


def test_cables_by_hand() -> None:
    """EN 1993-1-11, (6.2) and table 7.2; not compared with a source."""
    strand = codes.CableDesign(breaking=220.0, ending=0.9)
    assert strand.of("ULS") == pytest.approx(0.9 * 220.0 / 1.5)
    assert strand.of("frequent") == pytest.approx(0.45 * 0.9 * 220.0)
    rod = codes.CableDesign(breaking=220.0, proof=120.0, gamma_R=0.9)
    assert rod.of("accidental") == pytest.approx(120.0 / 0.9)
    for bad in (
        {"breaking": 0.0},
        {"breaking": 1.0, "ending": 1.2},
        {"breaking": 1.0, "proof": -1},
    ):
        with pytest.raises(InputError, match="CableDesign"):
            codes.CableDesign(**bad)  # type: ignore[arg-type]


def test_strengths_of_cables_by_limit_state(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 4, material=FOIL, side=4.0)
    a, b = (
        scene.lay_cable(Cable(EA=1e3), [(0.0, y), (4.0, y)], tension=2.0, name=name)
        for name, y in (("A", 1.3), ("B", 2.6))
    )
    scene.set_strengths((40.0, 40.0), cables={"A": codes.CableDesign(breaking=30.0), "B": 10.0})
    solver = Solver(scene)
    solver.advance()
    found = solver.combine({"U": {}, "C": {"state": "characteristic"}})
    used = {}
    for name, one in found.items():
        solver.restore(one.snapshot)
        cables = solver.summary().cables
        used[name] = [cables[x.name].utilisation for x in (a, b)]
    assert used["U"] == pytest.approx([a.tensions.max() / 20.0, b.tensions.max() / 10.0])
    assert used["C"] == [pytest.approx(a.tensions.max() / 13.5), None]
    with pytest.raises(InputError, match="strength of the cable 'A' = -1"):
        scene.set_strengths((40.0, 40.0), cables={"A": -1.0})
    ends = [scene.add_joint((x, 0.0, 3.0), held="xyz") for x in (0.0, 4.0)]
    scene.add_bar(Bar(EA=1e3), *ends, name="strut")
    scene.add_bar(Bar(EA=1e3, tension_only=True), *ends, name="guy")
    scene.set_strengths((40.0, 40.0), cables={"A": 9.0, "guy": 8.0})
    for name in ("a", "A1", "strut"):
        with pytest.raises(
            InputError, match=f"no cable or guy '{name}'; there are 'A', 'B', 'guy'"
        ):
            scene.set_strengths((4.0, 4.0), cables={"A": 9.0, name: 9.0})
    assert scene.design.cables == {"A": 9.0, "guy": 8.0} and scene.membrane.strengths != {}
    scene.set_strengths((40.0, 40.0), cables=7.0)  # also of cables that are laid later
    assert scene.design.of_cable("C", "ULS") == 7.0


@pytest.mark.parametrize(
    ("name", "A", "I"),
    [
        ("CHS 168.3x8", 40.3, 1297.0),
        ("CHS 114.3x5", 17.2, 257.0),
        ("SHS 100x5", 18.7, 279.0),
        ("RHS 100x50x5", 13.7, 54.3),  # about the weak axis
        ("RHS 50x100x5", 13.7, 54.3),
    ],
)
def test_sections_of_tables(name: str, A: float, I: float) -> None:  # noqa: E741
    """Areas (cm^2) and second moments (cm^4) as printed in tables of EN 10210-2."""
    bar = codes.steel_bar(name, 235e3)
    assert bar.EA / 210e6 * 1e4 == pytest.approx(A, abs=0.051)
    assert bar.EI is not None and bar.EI / 210e6 * 1e8 == pytest.approx(I, rel=2e-3)


def test_a_mast_by_the_buckling_curves() -> None:
    """CHS 168.3 x 8, 5.5 m, S235, 282.5 kN, by hand: slenderness 1.032, chi .643 (a), .521 (c)."""
    for curve, share in (("a", 0.464), ("c", 0.572)):
        mast = codes.steel_bar("CHS 168.3x8", 235e3, curve=curve)  # type: ignore[arg-type]
        chi, strength = mast.reduction(5.5), mast.strength
        assert chi is not None and strength is not None
        assert 282.5 / (chi * strength) == pytest.approx(share, abs=1e-3)
        # the slenderness is that of A f_y, whatever the partial factor
        divided = codes.steel_bar("CHS 168.3x8", 235e3, curve=curve, gamma_M=1.1)  # type: ignore[arg-type]
        assert divided.reduction(5.5) == pytest.approx(chi)
        assert divided.strength == pytest.approx(strength / 1.1)
        held = codes.steel_bar("CHS 168.3x8", 235e3, curve=curve, buckling_length=5.5)  # type: ignore[arg-type]
        assert held.reduction(11.0) == pytest.approx(chi)
    own = codes.steel_bar((40.3e-4, 1297e-8), 235e3, curve="a")
    assert isinstance(own, Bar) and own.EA == pytest.approx(210e6 * 40.3e-4)


@pytest.mark.parametrize(
    ("section", "f_y", "words"),
    [
        ("IPE 200", 235e3, "'IPE 200' is not a hollow section"),
        ("CHS 168.3", 235e3, "CHS 168.3"),
        ("CHS 10x8", 235e3, "CHS 10x8"),
        ("RHS 100x5", 235e3, "RHS 100x5"),
        ((0.0, 1.0), 235e3, "A of the section"),
        ("CHS 168.3x8", 235.0, "not those of steel; pass both in the same"),
        ("CHS 168.3x8", 0.0, "f_y = 0.0"),
    ],
)
def test_bad_sections(section: Any, f_y: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        codes.steel_bar(section, f_y)
