"""The catalogue of effects: what models usually lack, generated from a model's own structure."""
