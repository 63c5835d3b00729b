"""XML, YAML and JSON files, distinguished by their content and suffix."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import yaml

from palpate.errors import RecordError
from palpate.files import checked_file, read_bytes, read_errors

TREE_SUFFIXES = (".yml", ".yaml", ".json", ".xml")
# Largest YAML file [bytes]: it is parsed at 0.1 megabyte a second; calibrations have kilobytes.
_MAX_BYTES = 2**20
# Deepest nesting of brackets: the parser's time grows quadratically; matrices need two.
_MAX_NESTING = 50
_CURE = "export the calibration again"


def read_tree(path: Path) -> ElementTree.Element | dict[str, Any] | str:
    """Parsed content of an XML, YAML or JSON file; the text of any other.

    Parameters
    ----------
    path : Path                     YAML and JSON must have a suffix of `TREE_SUFFIXES`

    Returns
    -------
    Element, dict or str            root of XML, mapping of YAML or JSON, else the text

    Raises
    ------
    RecordError                     missing, not text, malformed XML or YAML, a duplicate key, an
                                    alias
    """
    data = read_bytes(path)
    if data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        with read_errors(path, _CURE, what="is not valid XML"):
            return ElementTree.fromstring(data.lstrip())
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordError(
            f"{path}: is not a text file in UTF-8, and no calibration of a known program"
        ) from error
    if path.suffix.lower() not in TREE_SUFFIXES:
        return text
    # OpenCV's first line (%YAML:1.0) is not valid YAML.
    body = text.partition("\n")[2] if text.startswith("%YAML") else text
    checked_file(path, max_bytes=_MAX_BYTES)
    with read_errors(path, _CURE, what="is not valid YAML"):
        root = yaml.load(body, Loader=_Loader)  # a SafeLoader: plain values only
    return root if isinstance(root, dict) else text


class _Loader(yaml.SafeLoader):
    """Plain values, and OpenCV's matrices as mappings; refuses duplicate keys, deep nesting and
    aliases."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """A node; aliases are refused, since nested ones can expand to billions of values."""
        if self.check_event(yaml.AliasEvent):
            alias = self.peek_event()
            raise ValueError(
                f"line {alias.start_mark.line + 1}: '*{alias.anchor}' stands for another value;"
                " write out the value itself"
            )
        return super().compose_node(parent, index)

    def fetch_flow_collection_start(self, token: type[yaml.Token]) -> None:
        """An opening bracket; refused beyond a nesting depth that no calibration has."""
        if self.flow_level == _MAX_NESTING:
            line = self.get_mark().line + 1
            raise ValueError(f"line {line}: more than {_MAX_NESTING} brackets are open")
        super().fetch_flow_collection_start(token)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """A mapping; duplicate keys, which YAML forbids but the parser accepts, are refused."""
        keys = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in keys:
                raise ValueError(f"line {key.start_mark.line + 1}: '{key.value}' is there twice")
            keys.add(str(key.value))
        return super().construct_mapping(node, deep=deep)


for _kind in ("opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(
        f"tag:yaml.org,2002:{_kind}", lambda loader, node: loader.construct_mapping(node, deep=True)
    )
