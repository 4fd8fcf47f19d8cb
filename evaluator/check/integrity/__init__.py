"""Everything that is wrong with a file, by name, also where more than one thing is.

``Recording.verify`` stops at the first damage, which is what a computation needs. Somebody who was sent a file needs to
know all of it.
"""

from gpusimbench.evaluator.check.integrity.examination import Integrity, examine

__all__ = ["Integrity", "examine"]
