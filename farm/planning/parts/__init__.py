"""Work on one model or part, in workers: decompose, slice, move cuts; and the rooms for parts."""
