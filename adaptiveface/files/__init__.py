"""Read files within limits, and replace files atomically: a path always holds either the old file or the whole new one."""

from .archive import Archive
from .atomic import reason, replacing, replacing_folder
from .bounded import decoded, is_own, open_regular, parse_json, read_bytes, read_json, read_text
from .folders import make_parent
from .mapped import blocks, map_member, release
from .outputs import (
    check_distinct,
    check_folder,
    check_new_folder,
    check_no_input,
    check_output,
    check_output_folder,
)
from .table import GrowingTable

__all__ = [
    "Archive",
    "GrowingTable",
    "blocks",
    "check_distinct",
    "check_folder",
    "check_new_folder",
    "check_no_input",
    "check_output",
    "check_output_folder",
    "decoded",
    "is_own",
    "make_parent",
    "map_member",
    "open_regular",
    "parse_json",
    "read_bytes",
    "read_json",
    "read_text",
    "reason",
    "release",
    "replacing",
    "replacing_folder",
]
