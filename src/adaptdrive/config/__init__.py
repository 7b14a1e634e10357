"""The configuration: one TOML file per drive, validated whole."""

from adaptdrive.config.file import load_configuration, parse_configuration
from adaptdrive.config.root import Configuration

__all__ = ["Configuration", "load_configuration", "parse_configuration"]
