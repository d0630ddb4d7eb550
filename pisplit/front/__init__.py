"""The front door: from recordings to a model, its report and a controller in one call each.

It stands above all rooms and is the only place in ``pisplit/`` that names models and controllers.
"""

from pisplit.front.control import Control
from pisplit.front.identification import Identified, identify
from pisplit.front.physical import physical_model
from pisplit.front.reidentification import ArmIdentifier, Causes
from pisplit.front.report import Report

__all__ = ["ArmIdentifier", "Causes", "Control", "Identified", "Report", "identify", "physical_model"]
