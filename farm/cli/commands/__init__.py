"""Commands, one file for each group; `farm.cli.main` lists them. A file is imported when it is needed."""
