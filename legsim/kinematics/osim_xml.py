"""OpenSim's XML documents, read as leniently as OpenSim reads them."""

import codecs
import re
from collections.abc import Collection
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from legsim.core import files
from legsim.core.errors import file_error


def document(path: Path, *, bare: Collection[str] = ()) -> Element:
    """The root element of an OpenSim XML file.

    ``bare`` are elements that may stand without the document around them, as in old files.

    Raises:
        LegsimError: the file cannot be read, or is not an OpenSim document.
    """
    text = files.content(path)
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise file_error(path, "declares a document type", "give a file that OpenSim wrote")
    try:
        root = ElementTree.fromstring(_as_xml(text))
    except ElementTree.ParseError as error:
        line, column = error.position
        raise file_error(
            path,
            f"is not whole XML ({error})",
            "copy the file again, or save it again from OpenSim",
            place=f"line {line}, column {column + 1}",
        ) from error
    except (LookupError, ValueError) as error:  # an encoding that Python does not know
        raise file_error(path, f"is not XML ({error})", "save it again from OpenSim") from error
    if root.tag not in ("OpenSimDocument", *bare):
        raise file_error(path, f"begins with <{root.tag}>", "give a file that OpenSim wrote")
    return root


def flag(element: Element, tag: str, *, missing: bool = False) -> bool:
    """Whether a child element is true, as OpenSim reads it: "true" or "1"; ``missing`` where there
    is none, or it is empty.
    """
    text = (element.findtext(tag) or "").strip().lower()
    return text in ("true", "1") if text else missing


def _as_xml(text: bytes) -> str:
    """What OpenSim reads although it is no XML, as XML: credits in Windows' code page, a bare &,
    names such as HuntCrossleyForce::ContactParameters.
    """
    try:
        marked = text.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        words = text.decode("utf-16" if marked else "utf-8-sig")
    except UnicodeDecodeError:
        words = text.decode("cp1252", errors="replace")
    words = re.sub(r"^\s*<\?xml[^>]*\?>", "", words)
    words = re.sub(r"&(?!(?:\w+|#\d+|#x[0-9A-Fa-f]+);)", "&amp;", words)
    return re.sub(r"(</?\w+)::", r"\1.", words)
