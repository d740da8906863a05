"""References of the methods: the publications to cite by work that used them.

The entries of ``references.bib`` repeat the sections References in the docstrings of the modules.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib.resources import files
from typing import NamedTuple

from acoustube.base.version import __version__

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
    "inversion": "the inversion of waveforms",
}
"""Descriptions of the methods by the topics of their references, in the order of the data flow."""


class Reference(NamedTuple):
    """A publication.

    Attributes
    ----------
    key : str
        BibTeX key.
    kind : str
        BibTeX type.
    topic : str
        Key of the method; see :data:`TOPICS`.
    author, title : str
        Authors in the order of the publication, joined by "and"; either may be empty.
    fields : dict of str
        Further BibTeX fields by name.
    """

    key: str
    kind: str
    topic: str
    author: str
    title: str
    fields: dict[str, str]

    def bibtex(self) -> str:
        """Return the entry in BibTeX."""
        known = {"author": self.author, "title": self.title} | self.fields
        lines = [f"  {name} = {{{value}}}," for name, value in known.items() if value]
        return "\n".join([f"@{self.kind}{{{self.key},", *lines, "}"])

    def in_words(self) -> str:
        """Return the entry as one line of text."""
        fields = dict(self.fields)
        year, doi = fields.pop("year", ""), fields.pop("doi", "")
        eprint = fields.pop("eprint", "")
        fields.pop("archiveprefix", None)
        if "volume" in fields:
            fields["volume"] = f"vol. {fields['volume']}"
        if "pages" in fields:
            fields["pages"] = fields["pages"].replace("--", "-")
        author = self.author.replace(" and others", " et al.").replace(" and ", "; ")
        year = "" if any(year in value for value in (self.title, *fields.values())) else year
        parts = [author, self.title, *fields.values(), year]
        parts += [f"doi:{doi}" if doi else "", f"arXiv:{eprint}" if eprint else ""]
        return ", ".join(part for part in parts if part).replace("{", "").replace("}", "")


def _read() -> list[Reference]:
    """Return the entries of ``references.bib``, where each field is one line."""
    text = files("acoustube.cli").joinpath("references.bib").read_text(encoding="utf-8")
    found = []
    for kind, key, entry in re.findall(r"@(\w+)\{(\w+),\n(.*?)\n\}", text, re.DOTALL):
        fields = dict(re.findall(r"  (\w+) = \{(.*)\},", entry.replace("VERSION", __version__)))
        topic, author, title = (fields.pop(name, "") for name in ("keywords", "author", "title"))
        found.append(Reference(key, kind, topic, author, title, fields))
    return found


REFERENCES = _read()
"""All references, in the order of :data:`TOPICS`."""


def references(topics: Iterable[str] | None = None) -> list[Reference]:
    """Return the references of some topics, or all of them.

    Parameters
    ----------
    topics : iterable of str, optional
        From :data:`TOPICS`. The topics software and sensor are always included.
    """
    wanted = set(TOPICS if topics is None else topics) | {"software", "sensor"}
    return [reference for reference in REFERENCES if reference.topic in wanted]
