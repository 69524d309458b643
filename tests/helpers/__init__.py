"""Tools that several tests share: references that are computed apart from the package, scenes."""
