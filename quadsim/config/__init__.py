"""Configuration: TOML goes in, a frozen, typed model or one clear error comes out; bounds and units."""
