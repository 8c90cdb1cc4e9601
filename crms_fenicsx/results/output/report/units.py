"""Units in a report."""

from __future__ import annotations

from dataclasses import dataclass

from crms_fenicsx.results.output.figures.plots import units_of_results


@dataclass(frozen=True)
class Units:
    """Units of length and force, as in headings."""

    length: str = ""  # such as "m" and "kN"; "" if unknown
    force: str = ""

    def __getitem__(self, kind: str) -> str:
        """Unit of a kind of quantity as " [m]"; "" if unknown."""
        unit = units_of_results(self.length, self.force).get(kind)
        return f" [{unit}]" if unit else ""

    def plain(self, kind: str) -> str:
        """Unit of a kind of quantity as " m", without brackets."""
        return self[kind].replace("[", "").replace("]", "")

    def headings(self, text: str) -> list[str]:
        """Headings from a text such as "Length{length}|State", with units."""
        return text.format_map(self).split("|")
