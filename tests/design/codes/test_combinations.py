"""Combinations by EN 1990 and ASCE 7: by hand, on a solver, and bad input."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from cabled_square import advanced, sheet
from mpi4py import MPI

from crms_fenicsx import FanControl, InputError, IsotropicMembrane, Solver
from crms_fenicsx.design.codes import asce7, asce7_16, asce7_22, combinations, en1990


def factors(table: dict[str, dict[str, object]]) -> set[tuple[tuple[str, object], ...]]:
    return {
        tuple(sorted((k, v) for k, v in one.items() if v and k != "state"))
        for one in table.values()
    }


def test_the_ultimate_limit_state_by_hand() -> None:
    """6.10 with g, snow (psi_0 = 0.5) and wind (0.6)."""
    found = factors(combinations(en1990, ["g"], ["snow", "wind"]))
    expected = set()
    for g in (1.35, 1.0):
        for rest in (
            {}, {"snow": 1.5}, {"wind": 1.5}, {"snow": 1.5, "wind": 0.9},
            {"snow": 0.75, "wind": 1.5},
        ):  # fmt: skip
            expected.add(tuple(sorted({"g": g, **rest}.items())))
    assert found == expected


def test_other_states_by_hand() -> None:
    def of(state: str) -> set[tuple[tuple[str, object], ...]]:
        return factors(combinations(en1990, ["g"], ["snow above 1000 m", "wind"], state=state))

    snow = "snow above 1000 m"
    assert (("g", 1.0), (snow, 1.0), ("wind", 0.6)) in of("characteristic")
    assert (("g", 1.0), (snow, 0.7), ("wind", 1.0)) in of("characteristic")
    assert of("frequent") == {
        (("g", 1.0),), (("g", 1.0), (snow, 0.5)), (("g", 1.0), ("wind", 0.2)),
        (("g", 1.0), (snow, 0.2), ("wind", 0.2)),
    }  # fmt: skip
    assert of("quasi-permanent") == {(("g", 1.0),), (("g", 1.0), (snow, 0.2))}
    pairs = of("ULS 6.10a/b")
    assert (("g", 1.35), (snow, 1.05), ("wind", 0.9)) in pairs  # a
    assert (("g", 1.1475), (snow, 1.5), ("wind", 0.9)) in pairs  # b, 0.85 x 1.35
    assert not any(("g", 1.35) in one and (snow, 1.5) in one for one in pairs)


def test_loads_of_a_kind_exclude_each_other() -> None:
    """And each combination names all loads, so that none stays on from before."""
    table = combinations(
        en1990,
        ["g", "fabric"],
        ["snow", "snow drifted", "wind x", "wind y"],
        also={"pressure": 0.6},
    )
    for name, one in table.items():
        assert not (one["wind x"] and one["wind y"])
        assert not (one["snow"] and one["snow drifted"])
        assert one["g"] == one["fabric"]
        assert one["pressure"] == 0.6
        assert set(one) == {
            "g", "fabric", "snow", "snow drifted", "wind x", "wind y", "pressure", "state"
        }  # fmt: skip
        assert name.startswith("ULS: ")
    assert "ULS: 1.35 g + 1.35 fabric + 1.5 snow drifted + 0.9 wind y" in table
    assert len(table) == 2 * (1 + 2 + 2 + 2 * 2 * 2)


def test_american_combinations_by_hand() -> None:
    """ASCE 7-16, 2.3.1, with D, S and W: 1.4 D; 1.2 D + .5 S; 1.2 D + 1.6 S (+ .5 W); 1.2 D + W +
    .5 S; .9 D + W. ASCE 7-22 has .3 and 1.0 of S."""
    assert asce7 is asce7_22
    for rules, lead, by in ((asce7_16, 1.6, 0.5), (asce7_22, 1.0, 0.3)):
        found = factors(combinations(rules, ["d"], ["snow", "wind"]))
        fewer = {(("d", 1.2),), (("d", 1.2), ("wind", 0.5)), (("d", 1.2), ("wind", 1.0))}
        # of rows with loads that there are not
        assert found - fewer == {
            (("d", 1.4),), (("d", 1.2), ("snow", by)), (("d", 1.2), ("snow", lead)),
            (("d", 1.2), ("snow", lead), ("wind", 0.5)), (("d", 1.2), ("snow", by), ("wind", 1.0)),
            (("d", 0.9), ("wind", 1.0)),
        }  # fmt: skip
    allowable = factors(combinations(asce7_16, ["d"], ["live", "snow"], state="allowable stress"))
    assert (("d", 1.0), ("live", 0.75), ("snow", 0.75)) in allowable
    assert (("d", 0.6),) in allowable
    for rules, snow in ((asce7_16, 1.0), (asce7_22, 0.7)):  # 3: D + (Lr or S, .7 S or R); 4
        found = factors(
            combinations(rules, ["d"], ["live", "snow", "rain"], state="allowable stress")
        )
        for roof, factor in (("snow", snow), ("rain", 1.0)):
            assert (("d", 1.0), (roof, factor)) in found
            assert (("d", 1.0), ("live", 0.75), (roof, round(0.75 * factor, 12))) in found


def test_the_combinations_of_a_building_code() -> None:
    """New York City's code, 1605.2, with D, Lr, S and W, equations 16-1 to 16-4 and 16-6, which has
    those of ASCE 7-16."""
    found = factors(combinations(asce7_16, ["d"], ["roof live", "snow", "wind"]))
    expected = {(("d", 1.4),), (("d", 0.9), ("wind", 1.0))}
    for roof in ("roof live", "snow"):
        for rest in ({roof: 0.5}, {roof: 1.6}, {roof: 1.6, "wind": 0.5}, {roof: 0.5, "wind": 1.0}):
            expected.add(tuple(sorted({"d": 1.2, **rest}.items())))
    assert expected <= found
    fewer = {(("d", 1.2),), (("d", 1.2), ("wind", 0.5)), (("d", 1.2), ("wind", 1.0))}
    assert found - expected <= fewer  # of rows with loads that there are not


def test_several_limit_states_in_one_table() -> None:
    """Each combination knows what it is for; prestress has its factors in (6.10) only."""
    states = ["ULS", "erection", "characteristic", "quasi-permanent"]
    table = combinations(en1990, ["g"], ["snow", "wind"], state=states, prestress=(1.2, 1.0))
    for name, one in table.items():
        assert one["state"] in states and name.startswith(f"{one['state']}: ")
        assert ("prestress" in one) <= (one["state"] in ("ULS", "erection"))
    counts = {state: sum(one["state"] == state for one in table.values()) for state in states}
    assert counts == {"ULS": 20, "erection": 20, "characteristic": 5, "quasi-permanent": 1}
    both = [one for name, one in table.items() if "1.2 prestress + 1.35 g + 1.5 snow + " in name]
    assert both and all(one["prestress"] == 1.2 and one["snow"] == 1.5 for one in both)


def test_accidents_by_hand() -> None:
    """(6.11b): G + A_d + psi_1,1 Q_1 + psi_2 Q_2, with snow (psi_1 = 0.2, psi_2 = 0) and wind."""
    accidents = {"A5 torn": {"without": ["A5"]}, "fans fail": {"pressure": 0.0}}
    table = combinations(
        en1990, ["g"], ["snow", "wind"], state="accidental", accidents=accidents,
        pressure={"snow": 0.6},
    )  # fmt: skip
    rest = ({}, {"snow": 0.2}, {"wind": 0.2})
    assert len(table) == 2 * len(rest)
    for name, one in table.items():
        assert one["g"] == 1.0 and {k: one[k] for k in ("snow", "wind") if one[k]} in rest
        torn = name.startswith("accidental: A5 torn + 1 g")
        assert one.get("without") == (["A5"] if torn else None)
        # what happens goes before what the fans would do
        fans = 0.6 if one["snow"] else None
        assert one.get("pressure") == (fans if torn else 0.0)


def test_pressures_follow_the_loads() -> None:
    table = combinations(
        en1990, ["g"], ["snow", "snow drifted", "wind x"], pressure={"snow": 0.6, "wind x": 0.4}
    )
    for one in table.values():
        snow, wind = one["snow"] or one["snow drifted"], one["wind x"]
        assert one.get("pressure") == (0.6 if snow else 0.4 if wind else None)


def test_pressures_by_fans_and_by_a_rule() -> None:
    """Fans go into all combinations but accidents that give a pressure; a rule sees what acts."""
    fans = [FanControl("snow", [0.0, 1.0], [0.3, 0.6]), FanControl("wind", [0.0, 1.0], [0.3, 0.5])]
    states = {"state": ["ULS", "accidental"], "accidents": {"a fan fails": {"pressure": 0.2}}}
    given = (en1990, ["g"], ["snow", "snow drifted", "wind x", "wind y"])
    table = combinations(*given, pressure=fans, **states)  # type: ignore[arg-type]
    for one in table.values():
        assert one["pressure"] is (fans if one["state"] == "ULS" else one["pressure"])
        assert one["state"] == "ULS" or one["pressure"] == 0.2
    single = combinations(*given, pressure=fans[0])
    assert all(one["pressure"] is fans[0] for one in single.values())

    def rule(acting: Mapping[str, float]) -> float | None:
        """Winter storms with more pressure than those of summer, without snow."""
        snow, wind = (any(x.startswith(kind) for x in acting) for kind in ("snow", "wind"))
        return 0.7 if snow and wind else 0.6 if snow else 0.4 if wind else None

    for one in combinations(*given, pressure=rule).values():
        snow, wind = (any(one[x] for x in given[2] if x[:4] == kind) for kind in ("snow", "wind"))
        expected = {(True, True): 0.7, (True, False): 0.6, (False, True): 0.4}
        assert one.get("pressure") == expected.get((snow, wind))


@pytest.mark.ranks
def test_a_table_is_solved(comm: MPI.Intracomm) -> None:
    scene = sheet(
        comm,
        4,
        material=IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=1.0),
        side=4.0,
    )
    scene.put_load((0.0, 0.0, -0.01), name="weight", per="material")
    scene.put_load((0.0, 0.0, -0.2), name="snow", per="plan")
    solver = advanced(Solver(scene), load={"weight": 1.0})
    table = combinations(en1990, ["weight"], ["snow"])
    found = solver.combine(table)
    assert list(found) == list(table)
    lift = {name: case.snapshot for name, case in found.items()}
    for name, state in lift.items():
        solver.restore(state)
        total = 16 * (0.01 * table[name]["weight"] + 0.2 * table[name]["snow"])  # type: ignore[operator]
        assert solver.reactions("boundary").total[2] == pytest.approx(total, rel=1e-3)


def test_bad_input() -> None:
    for arguments, message in (
        (
            {"variable": ["tornado"]},
            "load 'tornado' has the kind 'tornado', which EN 1990 does not",
        ),
        ({"variable": {"w": "storm"}}, "load 'w' has the kind 'storm'"),
        ({"variable": "snow"}, "not a valid list"),
        ({"variable": ["snow", "g"]}, "the load 'g' is listed twice"),
        ({"permanent": [], "variable": []}, "there are no loads"),
        ({"permanent": ["g", ""]}, "a load = '' is not a non-empty string"),
        ({"state": "SLS"}, "state of EN 1990 = 'SLS' is not known; use 'ULS', .*'frequent'"),
        ({"also": 3}, "also = 3 is not a valid mapping"),
        ({"also": {"state": "ULS"}}, "'state' in also has its own argument"),
        ({"also": {"prestress": 1.1}}, "'prestress' in also has its own argument"),
        ({"also": {"pressure": 1.0}, "pressure": {"snow": 0.6}}, "'pressure' in also has its own"),
        ({"pressure": {"wind": 0.6}}, "pressure of 'wind', but there is no variable load"),
        ({"pressure": {"snow": -0.6}}, "pressure of 'snow' = -0.6"),
        ({"pressure": []}, "pressure = .*is not a valid list"),
        ({"pressure": [0.6]}, "pressure is of type float; pass a FanControl"),
        ({"pressure": 0.6}, "pressure = 0.6"),
        ({"pressure": FanControl("wind", [0.0], [1.0])}, "pressure of 'wind', but there is no"),
        ({"pressure": lambda acting: -1.0}, r"of the rule for \{.*\} = -1.0"),
        ({"prestress": (1.2, 0.0)}, "prestress = 0.0"),
        ({"prestress": 1.2}, "prestress = 1.2"),
        ({"state": "accidental"}, 'the state "accidental", or neither'),
        ({"accidents": {"torn": {"without": ["A"]}}}, 'the state "accidental", or neither'),
        ({"state": "accidental", "accidents": {"torn": {}}}, "accident 'torn' = {}"),
    ):
        given = {"rules": en1990, "permanent": ["g"], "variable": ["snow"], **arguments}
        with pytest.raises(InputError, match=message):
            combinations(**given)
