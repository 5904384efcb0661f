"""The packages: all of elast_cli, and the presets of the top folder `configs`."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["elast_cli", "elast_cli.*"]), "elast_cli.configs"],
    package_dir={"elast_cli.configs": "configs"},
)
