"""What a problem's observations determine, and what they do not."""

from bundle.diagnosis.conditioning import Finding
from bundle.diagnosis.diagnose_problem import diagnose
from bundle.diagnosis.diagnosis_result import CollapsedCluster, Component, Diagnosis, WeakMode
from bundle.diagnosis.graph_diagnosis import (
    GraphComponent,
    GraphDiagnosis,
    GraphWeakMode,
    SuspiciousEdge,
)

__all__ = [
    "CollapsedCluster",
    "Component",
    "Diagnosis",
    "Finding",
    "GraphComponent",
    "GraphDiagnosis",
    "GraphWeakMode",
    "SuspiciousEdge",
    "WeakMode",
    "diagnose",
]
