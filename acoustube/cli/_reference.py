"""A publication, as text and in BibTeX."""

from __future__ import annotations

from typing import NamedTuple


class Reference(NamedTuple):
    """A publication.

    Attributes
    ----------
    key : str
        BibTeX key.
    kind : str
        BibTeX type.
    topic : str
        Key of the method; see :data:`acoustube.cli.references.TOPICS`.
    author, title : str
        Authors in the order of the publication, joined by "and"; either may be empty.
    fields : dict of str
        Further BibTeX fields.
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
