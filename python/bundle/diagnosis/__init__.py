"""What a problem's observations determine, and what they do not."""

from bundle.diagnosis.diagnose_problem import diagnose
from bundle.diagnosis.diagnosis_result import (
    CollapsedCluster,
    Component,
    Diagnosis,
    Finding,
    WeakMode,
)

__all__ = ["CollapsedCluster", "Component", "Diagnosis", "Finding", "WeakMode", "diagnose"]
