"""Names that figures of the page had before documents."""

from __future__ import annotations

from gpusimbench.evaluator.render.document import Figure as Picture
from gpusimbench.evaluator.render.document import Numbers
from gpusimbench.evaluator.render.document import key_of as file_name
from gpusimbench.evaluator.render.html import LARGEST_CSV

__all__ = ["LARGEST_CSV", "Numbers", "Picture", "file_name"]
