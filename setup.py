"""What pyproject.toml cannot say: the packages of three folders, and data files of an editable installation."""

from setuptools import Distribution, find_packages, setup


class DistributionWithData(Distribution):
    """A distribution whose data files an editable installation copies: it asks for `has_data`, which setuptools calls otherwise."""

    has_data = Distribution.has_data_files


found = find_packages(include=["isd_gym", "isd_gym.*"])
setup(
    distclass=DistributionWithData,
    packages=sorted({*found, "isd_gym.agents", "isd_gym.baselines"}),
)
