"""Form finding: the shape in equilibrium with given section forces, cables and pressure."""

from crms_fenicsx.design.form_finding.find_form import find_form
from crms_fenicsx.design.form_finding.form_bars import FormBar
from crms_fenicsx.design.form_finding.form_cables import FormCable, FormCableFound
from crms_fenicsx.design.form_finding.found_form import FoundForm

__all__ = ["FormBar", "FormCable", "FormCableFound", "FoundForm", "find_form"]
