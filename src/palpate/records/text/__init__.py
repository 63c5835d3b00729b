"""text."""

from palpate.records.text.csv_table import (
    Column as Column,
    TextTable as TextTable,
    read_text_table as read_text_table,
)
from palpate.records.text.toml_table import (
    TomlTable as TomlTable,
    nearest_word as nearest_word,
    read_toml as read_toml,
)
