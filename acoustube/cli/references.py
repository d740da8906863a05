"""References of the methods: the publications to cite by work that used them.

Each entry repeats the section References in the docstring of the module that uses it.
"""

from __future__ import annotations

from collections.abc import Iterable

from acoustube.base.version import __version__
from acoustube.cli._mechanics_references import MECHANICS
from acoustube.cli._reference import Reference

TOPICS = {
    "software": "the program",
    "sensor": "the sensor, its signals and its estimators",
    "press": "the press: elements, material and contact",
    "folds": "the folds of a deep press",
    "surface": "meshes of imported walls",
    "mooney": "the Mooney-Rivlin material",
    "air": "the air in the tube",
    "losses": "losses at the wall and in the air",
    "absorber": "absorbing ends",
    "grid": "the grid and the time steps",
    "scattering": "scattering matrices",
    "cascade": "scattering matrices joined to straight tube",
    "bends": "bends",
    "rangefinder": "the rangefinder",
    "arm": "the axis of an arm from markers",
    "flattening": "the flattening of a wrapped tube",
    "tissue": "the tissue of an arm",
    "contacts": "contacts followed from cycle to cycle",
    "network": "networks",
    "ensemble": "ensembles of networks",
    "intervals": "prediction intervals",
}
"""Methods by the keys of their references, in the order of the data."""

_STATISTICS = "Journal of the American Statistical Association"

REFERENCES = (
    Reference(
        "acoustube", "software", "software", "{acoustube developers}",
        "{acoustube: simulating a soft tube that feels by ultrasound}",
        {"version": __version__},
    ),
    Reference(
        "sleeve_paper", "misc", "sensor", "",
        "Wearable, Fabric-Embedded Acoustic Waveguides for Meter-Scale Contact Localization and "
        "Force Sensing",
        {},
    ),
    Reference(
        "turin1960", "article", "sensor", "Turin, G. L.", "An introduction to matched filters",
        {"journal": "IRE Transactions on Information Theory", "volume": "6", "pages": "311--329",
         "year": "1960", "doi": "10.1109/TIT.1960.1057571"},
    ),
    Reference(
        "hampel1974", "article", "sensor", "Hampel, F. R.",
        "The influence curve and its role in robust estimation",
        {"journal": _STATISTICS, "volume": "69", "pages": "383--393", "year": "1974",
         "doi": "10.1080/01621459.1974.10482962"},
    ),
    Reference(
        "cheshire1999", "article", "sensor", "Cheshire, S. and Baker, M.",
        "Consistent overhead byte stuffing",
        {"journal": "IEEE/ACM Transactions on Networking", "volume": "7", "pages": "159--172",
         "year": "1999", "doi": "10.1109/90.769765"},
    ),
    *MECHANICS,
    Reference(
        "atmosphere1976", "techreport", "air", "", "{U.S. Standard Atmosphere}, 1976",
        {"number": "NOAA-S/T 76-1562", "year": "1976"},
    ),
    Reference(
        "iso9613", "techreport", "losses", "{International Organization for Standardization}",
        "Acoustics - Attenuation of sound during propagation outdoors - Part 1: Calculation of "
        "the absorption of sound by the atmosphere",
        {"number": "ISO 9613-1:1993", "year": "1993"},
    ),
    Reference(
        "kirchhoff1868", "article", "losses",
        "Kirchhoff, G.",
        "{Ueber den Einfluss der Wärmeleitung in einem Gase auf die Schallbewegung}",
        {"journal": "Annalen der Physik", "volume": "210", "pages": "177--193", "year": "1868",
         "doi": "10.1002/andp.18682100602"},
    ),
    Reference(
        "zwikker1949", "book", "losses",
        "Zwikker, C. and Kosten, C. W.",
        "Sound Absorbing Materials",
        {"publisher": "Elsevier", "year": "1949"},
    ),
    Reference(
        "tijdeman1975", "article", "losses",
        "Tijdeman, H.",
        "On the propagation of sound waves in cylindrical tubes",
        {"journal": "Journal of Sound and Vibration", "volume": "39", "pages": "1--33",
         "year": "1975", "doi": "10.1016/S0022-460X(75)80206-9"},
    ),
    Reference(
        "bruneau1987", "article", "losses",
        "Bruneau, A. M. and Bruneau, M. and Herzog, P. and Kergomard, J.",
        "Boundary layer attenuation of higher order modes in waveguides",
        {"journal": "Journal of Sound and Vibration", "volume": "119", "pages": "15--27",
         "year": "1987", "doi": "10.1016/0022-460X(87)90186-6"},
    ),
    Reference(
        "bilbao2016", "article", "losses",
        "Bilbao, S. and Harrison, R.",
        "Passive time-domain numerical models of viscothermal wave propagation in "
        "acoustic tubes of variable cross section",
        {"journal": "Journal of the Acoustical Society of America", "volume": "140",
         "pages": "728--740", "year": "2016", "doi": "10.1121/1.4959025"},
    ),
    Reference(
        "berggren2018", "article", "losses",
        "Berggren, M. and Bernland, A. and Noreland, D.",
        "Acoustic boundary layers as boundary conditions",
        {"journal": "Journal of Computational Physics", "volume": "371", "pages": "633--650",
         "year": "2018", "doi": "10.1016/j.jcp.2018.06.005"},
    ),
    Reference(
        "hagg2022", "misc", "losses",
        "Hägg, L. and Berggren, M.",
        "Investigations of an effective time-domain boundary condition for quiescent "
        "viscothermal acoustics",
        {"year": "2022", "archiveprefix": "arXiv", "eprint": "2207.03152"},
    ),
    Reference(
        "roden2000", "article", "absorber", "Roden, J. A. and Gedney, S. D.",
        "Convolution {PML} ({CPML}): an efficient {FDTD} implementation of the {CFS-PML} for "
        "arbitrary media",
        {"journal": "Microwave and Optical Technology Letters", "volume": "27",
         "pages": "334--339", "year": "2000",
         "doi": "10.1002/1098-2760(20001205)27:5<334::AID-MOP14>3.0.CO;2-A"},
    ),
    Reference(
        "yee1966", "article", "grid",
        "Yee, K.",
        "Numerical solution of initial boundary value problems involving Maxwell's "
        "equations in isotropic media",
        {"journal": "IEEE Transactions on Antennas and Propagation", "volume": "14",
         "pages": "302--307", "year": "1966", "doi": "10.1109/TAP.1966.1138693"},
    ),
    Reference(
        "botteldooren1995", "article", "grid",
        "Botteldooren, D.",
        "Finite-difference time-domain simulation of low-frequency room acoustic "
        "problems",
        {"journal": "Journal of the Acoustical Society of America", "volume": "98",
         "pages": "3302--3308", "year": "1995"},
    ),
    Reference(
        "dey1997", "article", "grid",
        "Dey, S. and Mittra, R.",
        "A locally conformal finite-difference time-domain ({FDTD}) algorithm for "
        "modeling three-dimensional perfectly conducting objects",
        {"journal": "IEEE Microwave and Guided Wave Letters", "volume": "7", "pages": "273--275",
         "year": "1997"},
    ),
    Reference(
        "tolan2003", "article", "grid",
        "Tolan, J. G. and Schneider, J. B.",
        "Locally conformal method for acoustic finite-difference time-domain modeling "
        "of rigid surfaces",
        {"journal": "Journal of the Acoustical Society of America", "volume": "114",
         "pages": "2575--2581", "year": "2003"},
    ),
    Reference(
        "xiao2004", "article", "grid",
        "Xiao, T. and Liu, Q. H.",
        "Enlarged cells for the conformal {FDTD} method to avoid the time step "
        "reduction",
        {"journal": "IEEE Microwave and Wireless Components Letters", "volume": "14",
         "pages": "551--553", "year": "2004"},
    ),
    Reference(
        "bilbao2013", "article", "grid",
        "Bilbao, S.",
        "Modeling of complex geometries and boundary conditions in finite "
        "difference/finite volume time domain room acoustics simulation",
        {"journal": "IEEE Transactions on Audio, Speech, and Language Processing",
         "volume": "21", "pages": "1524--1533", "year": "2013",
         "doi": "10.1109/TASL.2013.2256897"},
    ),
    Reference(
        "lanczos1950", "article", "grid",
        "Lanczos, C.",
        "An iteration method for the solution of the eigenvalue problem of linear "
        "differential and integral operators",
        {"journal": "Journal of Research of the National Bureau of Standards", "volume": "45",
         "pages": "255--282", "year": "1950", "doi": "10.6028/jres.045.026"},
    ),
    Reference(
        "abom1991", "article", "scattering",
        "Åbom, M.",
        "Measurement of the scattering-matrix of acoustical two-ports",
        {"journal": "Mechanical Systems and Signal Processing", "volume": "5",
         "pages": "89--104", "year": "1991", "doi": "10.1016/0888-3270(91)90017-Y"},
    ),
    Reference(
        "ruhe1984", "article", "scattering",
        "Ruhe, A.",
        "Rational {Krylov} sequence methods for eigenvalue computation",
        {"journal": "Linear Algebra and its Applications", "volume": "58", "pages": "391--405",
         "year": "1984", "doi": "10.1016/0024-3795(84)90221-0"},
    ),
    Reference(
        "henrot2018", "book", "scattering", "Henrot, A. and Pierre, M.",
        "Shape variation and optimization",
        {"publisher": "European Mathematical Society", "year": "2018", "doi": "10.4171/178"},
    ),
    Reference(
        "rabiner1969", "article", "scattering",
        "Rabiner, L. R. and Schafer, R. W. and Rader, C. M.",
        "The chirp z-transform algorithm",
        {"journal": "IEEE Transactions on Audio and Electroacoustics", "volume": "17",
         "pages": "86--92", "year": "1969", "doi": "10.1109/TAU.1969.1162034"},
    ),
    Reference(
        "redheffer1962", "article", "cascade", "Redheffer, R.",
        "On the relation of transmission-line theory to scattering and transfer",
        {"journal": "Journal of Mathematics and Physics", "volume": "41", "pages": "1--41",
         "year": "1962", "doi": "10.1002/sapm19624111"},
    ),
    Reference(
        "felix2001", "article", "bends", "Félix, S. and Pagneux, V.",
        "Sound propagation in rigid bends: a multimodal approach",
        {"journal": "Journal of the Acoustical Society of America", "volume": "110",
         "pages": "1329--1337", "year": "2001"},
    ),
    Reference(
        "felix2002", "article", "bends", "Félix, S. and Pagneux, V.",
        "Multimodal analysis of acoustic propagation in three-dimensional bends",
        {"journal": "Wave Motion", "volume": "36", "pages": "157--168", "year": "2002",
         "doi": "10.1016/S0165-2125(02)00009-4"},
    ),
    Reference(
        "maxbotix", "manual", "rangefinder", "{MaxBotix}",
        "{LV-MaxSonar-EZ1} ({MB1010}), data sheet", {},
    ),
    Reference(
        "ti_am335x", "manual", "rangefinder", "{Texas Instruments}",
        "{AM335x}, reference manual", {},
    ),
    Reference(
        "echotube2019", "inproceedings", "rangefinder", "", "{EchoTube}",
        {"booktitle": "ISS 2019", "year": "2019", "doi": "10.1145/3343055.3359712"},
    ),
    Reference(
        "morse1968", "book", "rangefinder", "Morse, P. M. and Ingard, K. U.",
        "Theoretical Acoustics", {"publisher": "McGraw-Hill", "year": "1968"},
    ),
    Reference(
        "salmon2011", "inproceedings", "rangefinder", "Salmon, J. K. and others",
        "Parallel random numbers: as easy as 1, 2, 3",
        {"booktitle": "SC '11", "year": "2011", "doi": "10.1145/2063384.2063405"},
    ),
    Reference(
        "rousseeuw1984", "article", "arm", "Rousseeuw, P. J.",
        "Least median of squares regression",
        {"journal": _STATISTICS, "volume": "79", "pages": "871--880", "year": "1984",
         "doi": "10.1080/01621459.1984.10477105"},
    ),
    Reference(
        "brazier1927", "article", "flattening", "Brazier, L. G.",
        "On the flexure of thin cylindrical shells and other \"thin\" sections",
        {"journal": "Proceedings of the Royal Society A", "volume": "116", "pages": "104--114",
         "year": "1927", "doi": "10.1098/rspa.1927.0125"},
    ),
    Reference(
        "zheng1999", "article", "tissue", "Zheng, Y. and Mak, A. F. T.",
        "Extraction of quasi-linear viscoelastic parameters for lower limb soft tissues from "
        "manual indentation experiment",
        {"journal": "Journal of Biomechanical Engineering", "volume": "121", "pages": "330--339",
         "year": "1999"},
    ),
    Reference(
        "iivarinen2011", "article", "tissue", "Iivarinen, J. T. and others",
        "Experimental and computational analysis of soft tissue stiffness in forearm using a "
        "manual indentation device",
        {"journal": "Medical Engineering and Physics", "volume": "33", "pages": "1245--1253",
         "year": "2011", "doi": "10.1016/j.medengphy.2011.05.015"},
    ),
    Reference(
        "isogai2022", "article", "tissue", "Isogai, K. and others",
        "Young's moduli of subcutaneous tissues and muscles under different loads at the gluteal "
        "region calculated using ultrasonography",
        {"journal": "Journal of Physical Therapy Science", "volume": "34", "pages": "777--783",
         "year": "2022", "doi": "10.1589/jpts.34.777"},
    ),
    Reference(
        "barshalom2001", "book", "contacts",
        "Bar-Shalom, Y. and Li, X. R. and Kirubarajan, T.",
        "Estimation with Applications to Tracking and Navigation",
        {"publisher": "Wiley", "year": "2001", "doi": "10.1002/0471221279"},
    ),
    Reference(
        "blackman1999", "book", "contacts", "Blackman, S. and Popoli, R.",
        "Design and Analysis of Modern Tracking Systems",
        {"publisher": "Artech House", "year": "1999"},
    ),
    Reference(
        "he2015", "inproceedings", "network", "He, K. and others", "Delving deep into rectifiers",
        {"booktitle": "ICCV 2015", "year": "2015", "doi": "10.1109/ICCV.2015.123"},
    ),
    Reference(
        "lakshminarayanan2017", "inproceedings", "ensemble", "Lakshminarayanan, B. and others",
        "Simple and scalable predictive uncertainty estimation using deep ensembles",
        {"booktitle": "NeurIPS 2017", "year": "2017", "archiveprefix": "arXiv",
         "eprint": "1612.01474"},
    ),
    Reference(
        "lei2018", "article", "intervals", "Lei, J. and others",
        "Distribution-free predictive inference for regression",
        {"journal": _STATISTICS, "volume": "113", "pages": "1094--1111", "year": "2018",
         "doi": "10.1080/01621459.2017.1307116"},
    ),
)  # fmt: skip
"""All of them, in the order of :data:`TOPICS`."""


def references(topics: Iterable[str] | None = None) -> list[Reference]:
    """Return the references of some topics, or all of them.

    Parameters
    ----------
    topics : iterable of str, optional
        From :data:`TOPICS`. The program itself and the sensor's paper are always among them.
    """
    wanted = set(TOPICS if topics is None else topics) | {"software", "sensor"}
    return [reference for reference in REFERENCES if reference.topic in wanted]
