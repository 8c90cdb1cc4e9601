"""Names of the units of a report."""

from __future__ import annotations

from dataclasses import dataclass

from crms_fenicsx.output.figures.plots import units_of_results


@dataclass(frozen=True)
class Units:
    """Names of units, as in headings."""

    length: str = ""  # length, force: such as "m" and "kN"; "" where not given
    force: str = ""

    def __getitem__(self, kind: str) -> str:
        """The unit of a kind in brackets after a blank; "" where not known."""
        unit = units_of_results(self.length, self.force).get(kind)
        return f" [{unit}]" if unit else ""

    def plain(self, kind: str) -> str:
        """The unit of a kind after a blank, without brackets."""
        return self[kind].replace("[", "").replace("]", "")

    def headings(self, text: str) -> list[str]:
        """Headings from texts between "|" that name kinds of units, as "Length{length}"."""
        return text.format_map(self).split("|")
