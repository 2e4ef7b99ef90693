"""Tests of pneuma.env; a package, because other folders of tests have files of the same names."""
