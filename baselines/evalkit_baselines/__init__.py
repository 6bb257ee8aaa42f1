"""Back ends and mappers of evalkit, one file or package each."""
