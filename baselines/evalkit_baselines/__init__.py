"""Back ends and mappers that ship with evalkit, one file each."""
