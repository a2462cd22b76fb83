"""Parts of a job: tasks of workers (decompose, slice, move cuts, draw), and their division among workers."""
