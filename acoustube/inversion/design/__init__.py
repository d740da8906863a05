"""Expected accuracy of a sensor before it is built, for choosing tube, transducer and pulse.

Reading order: `echoes` (reflection by the presses of a tube, and the contacts to be estimated),
`fisher` (information of a contact at each frequency), `electronics` (pulse, transducer and
converter), `prediction` (standard deviations, half-wave errors, reach and resolution for one pulse,
differentiable) and `pairs` (two presses at once).
"""

from acoustube.inversion.design.echoes import Contacts, PressedTube
from acoustube.inversion.design.electronics import Electronics
from acoustube.inversion.design.fisher import Information, information
from acoustube.inversion.design.pairs import Pairs, predict_pairs
from acoustube.inversion.design.prediction import Prediction, gradient, predict

__all__ = [
    "Contacts", "Electronics", "Information", "Pairs", "Prediction", "PressedTube", "gradient",
    "information", "predict", "predict_pairs",
]  # fmt: skip
