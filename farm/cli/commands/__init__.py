"""Commands, one file for each group; the table in `farm.cli.main` names them, and imports one on use."""
