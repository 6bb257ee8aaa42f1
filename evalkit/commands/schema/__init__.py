"""``evalkit schema``: the JSON Schema of experiment, study and tuning files, for editors."""
