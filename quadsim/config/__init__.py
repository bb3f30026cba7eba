"""Configuration: TOML files are parsed into frozen, typed models whose numbers have bounds and units."""
