"""The ZIP package of a 3MF file, which is unpacked in memory only.

Source: Open Packaging Conventions (ECMA-376 part 2), as the 3MF core specification uses them.
"""

from __future__ import annotations

import io
import posixpath
import re
import zipfile
import zlib
from collections.abc import Iterator
from xml.parsers import expat

from decompose.errors import ModelUnreadable

MAX_ENTRIES = 10_000
MAX_UNCHECKED_BYTES = 64 * 2**20  # unpacked size up to which any compression ratio is allowed
MAX_COMPRESSION_RATIO = 100  # maximum ratio of unpacked to packed bytes; for meshes in XML it is 4 to 40
MAX_UNPACKED_BYTES = 2 * 2**30  # maximum unpacked size of all parts that are read
MAX_RELATIONSHIPS_BYTES = 2**20
CHUNK_BYTES = 2**18

_ENTRY_SIGNATURE = b"PK\x01\x02"
_RELATIONSHIPS_PART = "_rels/.rels"
_MODEL_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_RELATIONSHIP_TAG = "http://schemas.openxmlformats.org/package/2006/relationships Relationship"
_SETTINGS_PARTS = ("metadata/model_settings.config", "metadata/slic3r_pe_model.config")
_MODIFIER_PATTERN = re.compile(
    rb'subtype="(?!normal_part)\w+"|key="modifier"\s+value="1"|key="volume_type"\s+value="(?!ModelPart)\w+"'
)


class Package:
    """Parts of a 3MF file by name.

    Parameters
    ----------
    name
        Name of the file, for messages.
    data
        Content of the file.

    Raises
    ------
    ModelUnreadable
        The file is not a ZIP package, or has too many entries.
    """

    def __init__(self, name: str, data: bytes) -> None:
        self._name = name
        self._unpacked_bytes = 0
        if data.count(_ENTRY_SIGNATURE) > MAX_ENTRIES:
            raise ModelUnreadable(f"{name}: has more than {MAX_ENTRIES} entries; export it again")
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(data))
        except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError) as error:
            raise ModelUnreadable(
                f"{name}: not a 3MF or only a part of one ({error}); copy or export it again"
            ) from error
        self._entries = {_make_key(entry.filename): entry for entry in self._zip.infolist()}

    def find_model(self) -> str:
        """Find the name of the part with the model, by the package's relationships."""
        targets: list[str] = []

        def add_target(tag: str, attributes: dict[str, str]) -> None:
            if tag == _RELATIONSHIP_TAG and attributes.get("Type") == _MODEL_TYPE:
                targets.append(attributes.get("Target", ""))

        parser = make_parser(self._name)
        parser.StartElementHandler = add_target
        parse_chunks(
            parser, self._name, _RELATIONSHIPS_PART, self.unpack(_RELATIONSHIPS_PART, MAX_RELATIONSHIPS_BYTES)
        )
        if not targets:
            raise ModelUnreadable(f"{self._name}: its relationships name no 3D model; export it again")
        return targets[0]

    def unpack(self, part: str, max_bytes: int = MAX_UNPACKED_BYTES) -> Iterator[bytes]:
        """Yield the bytes of a part in chunks.

        Parameters
        ----------
        part
            Name of the part.
        max_bytes
            Maximum unpacked size.

        Raises
        ------
        ModelUnreadable
            The part is missing, damaged or encrypted, or unpacks to too many bytes.
        """
        entry = self._entries.get(_make_key(part))
        if entry is None:
            raise ModelUnreadable(f"{self._name}: its part {_quote_part(part)} is missing; export it again")
        size, packed_size = entry.file_size, max(1, entry.compress_size)
        self._unpacked_bytes += size
        if (
            size > max_bytes
            or self._unpacked_bytes > MAX_UNPACKED_BYTES
            or (size > MAX_UNCHECKED_BYTES and size > packed_size * MAX_COMPRESSION_RATIO)
        ):
            raise ModelUnreadable(
                f"{self._name}: its part {_quote_part(part)} unpacks from {packed_size / 1e6:.1f} MB to "
                f"{size / 1e6:.0f} MB, which no model does; export it again"
            )
        if entry.flag_bits & 1:
            raise ModelUnreadable(f"{self._name}: is encrypted; export it without a password")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ModelUnreadable(
                f"{self._name}: uses a compression that 3MF does not allow; export it again"
            )
        try:
            with self._zip.open(entry) as stream:
                while chunk := stream.read(CHUNK_BYTES):
                    yield chunk
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, NotImplementedError) as error:
            raise ModelUnreadable(
                f"{self._name}: its part {_quote_part(part)} is damaged ({error}); copy or export it again"
            ) from error

    def has_modifiers(self) -> bool:
        """Check whether a slicer has marked volumes as modifiers, as negative or as supports."""
        return any(
            _MODIFIER_PATTERN.search(b"".join(self.unpack(part)))
            for part in _SETTINGS_PARTS
            if part in self._entries and self._entries[part].file_size <= MAX_RELATIONSHIPS_BYTES
        )


def resolve_path(path: str) -> str:
    """Resolve a reference to a part of the package, and return the part's name."""
    return posixpath.normpath("/" + path.replace("\\", "/")).lstrip("/")


def _make_key(name: str) -> str:
    """Make the key of a part from its name; upper and lower case give the same key."""
    return resolve_path(name).lower()


def _quote_part(part: str) -> str:
    """Shorten a part's name for a message, and replace unprintable characters."""
    return "".join(c if c.isprintable() else "?" for c in part[:80])


def make_parser(name: str) -> expat.XMLParserType:
    """Make an XML parser that prefixes tags with their namespace and refuses document types and entities."""
    parser = expat.ParserCreate(namespace_separator=" ")

    def refuse_doctype(*_: object) -> None:
        raise ModelUnreadable(
            f"{name}: defines a document type or entities, which 3MF forbids; export it again"
        )

    parser.StartDoctypeDeclHandler = refuse_doctype
    return parser


MAX_TAG_BYTES = 2**20


def parse_chunks(parser: expat.XMLParserType, name: str, part: str, chunks: Iterator[bytes]) -> None:
    """Feed the bytes of a part to a parser; raise ModelUnreadable if they are not XML.

    Parameters
    ----------
    parser
        Parser from `make_parser`.
    name, part
        Names of the file and of the part, for messages.
    chunks
        Bytes of the part.
    """
    fed_bytes = 0
    try:
        for chunk in chunks:
            parser.Parse(chunk, False)
            fed_bytes += len(chunk)
            if fed_bytes - max(0, parser.CurrentByteIndex) > MAX_TAG_BYTES + CHUNK_BYTES:
                raise ModelUnreadable(f"{name}: has a tag of more than 1 MB; export it again")
        parser.Parse(b"", True)
    except expat.ExpatError as error:
        raise ModelUnreadable(
            f"{name}: its part {_quote_part(part)} is not XML ({error}); copy or export it again"
        ) from error
