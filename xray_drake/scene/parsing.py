"""Tells Drake's parser where the package's models are."""

from pydrake.multibody.parsing import Parser

from xray_drake.resources import PACKAGE_NAME, models_dir


def configure_parser(parser: Parser) -> None:
    """Registers ``package://xray_drake_models`` with a parser.

    Args:
        parser: of any plant; asking twice does no harm.

    Raises:
        FileNotFoundError: the models are not where they should be.
    """
    packages = parser.package_map()
    if not packages.Contains(PACKAGE_NAME):
        packages.Add(PACKAGE_NAME, str(models_dir()))


ConfigureParser = configure_parser
"""The name that Drake's own model packages use."""
