"""References of the mechanics: elements, material, contact, solvers and meshes."""

from __future__ import annotations

from acoustube.cli._reference import Reference

_GRAPHICS = "ACM Transactions on Graphics"

MECHANICS = (
    Reference(
        "simo1985", "article", "press", "Simo, J. C. and Taylor, R. L. and Pister, K. S.",
        "Variational and projection methods for the volume constraint in finite deformation "
        "elasto-plasticity",
        {"journal": "Computer Methods in Applied Mechanics and Engineering", "volume": "51",
         "pages": "177--208", "year": "1985", "doi": "10.1016/0045-7825(85)90033-7"},
    ),
    Reference(
        "qi2003", "article", "press", "Qi, H. J. and Joyce, K. and Boyce, M. C.",
        "Durometer hardness and the stress-strain behavior of elastomeric materials",
        {"journal": "Rubber Chemistry and Technology", "volume": "76", "pages": "419--435",
         "year": "2003", "doi": "10.5254/1.3547752"},
    ),
    Reference(
        "rivlin1948", "article", "press", "Rivlin, R. S.",
        "Large elastic deformations of isotropic materials {I}: fundamental concepts",
        {"journal": "Philosophical Transactions of the Royal Society A", "volume": "240",
         "pages": "459--490", "year": "1948", "doi": "10.1098/rsta.1948.0002"},
    ),
    Reference(
        "flory1961", "article", "press", "Flory, P. J.",
        "Thermodynamic relations for high elastic materials",
        {"journal": "Transactions of the Faraday Society", "volume": "57", "pages": "829--838",
         "year": "1961", "doi": "10.1039/TF9615700829"},
    ),
    Reference(
        "li2020", "article", "press",
        "Li, M. and Ferguson, Z. and Schneider, T. and Langlois, T. and Zorin, D. and Panozzo, D. "
        "and Jiang, C. and Kaufman, D. M.",
        "Incremental potential contact: intersection- and inversion-free, large-deformation "
        "dynamics",
        {"journal": _GRAPHICS, "volume": "39", "pages": "49", "year": "2020",
         "doi": "10.1145/3386569.3392425"},
    ),
    Reference(
        "wang2021", "article", "press",
        "Wang, B. and Ferguson, Z. and Schneider, T. and Jiang, X. and Attene, M. and Panozzo, D.",
        "A large-scale benchmark and an inclusion-based algorithm for continuous collision "
        "detection",
        {"journal": _GRAPHICS, "volume": "40", "pages": "188", "year": "2021",
         "doi": "10.1145/3460775"},
    ),
    Reference(
        "armijo1966", "article", "press", "Armijo, L.",
        "Minimization of functions having Lipschitz continuous first partial derivatives",
        {"journal": "Pacific Journal of Mathematics", "volume": "16", "pages": "1--3",
         "year": "1966", "doi": "10.2140/pjm.1966.16.1"},
    ),
    Reference(
        "nocedal2006", "book", "press", "Nocedal, J. and Wright, S. J.",
        "Numerical Optimization",
        {"publisher": "Springer", "year": "2006", "doi": "10.1007/978-0-387-40065-5"},
    ),
    Reference(
        "hong2009", "article", "folds", "Hong, W. and Zhao, X. and Suo, Z.",
        "Formation of creases on the surfaces of elastomers and gels",
        {"journal": "Applied Physics Letters", "volume": "95", "pages": "111901",
         "year": "2009"},
    ),
    Reference(
        "biot1963", "article", "folds", "Biot, M. A.",
        "Surface instability of rubber in compression",
        {"journal": "Applied Scientific Research, Section A", "volume": "12", "pages": "168--182",
         "year": "1963"},
    ),
    Reference(
        "hu2020", "article", "surface",
        "Hu, Y. and Schneider, T. and Wang, B. and Zorin, D. and Panozzo, D.",
        "Fast tetrahedral meshing in the wild",
        {"journal": _GRAPHICS, "volume": "39", "pages": "117", "year": "2020",
         "doi": "10.1145/3386569.3392385"},
    ),
    Reference(
        "mooney1940", "article", "mooney", "Mooney, M.",
        "A theory of large elastic deformation",
        {"journal": "Journal of Applied Physics", "volume": "11", "pages": "582--592",
         "year": "1940", "doi": "10.1063/1.1712836"},
    ),
    Reference(
        "rivlin1951", "article", "mooney", "Rivlin, R. S. and Saunders, D. W.",
        "Large elastic deformations of isotropic materials {VII}",
        {"journal": "Philosophical Transactions of the Royal Society A", "volume": "243",
         "pages": "251--288", "year": "1951", "doi": "10.1098/rsta.1951.0004"},
    ),
)  # fmt: skip
