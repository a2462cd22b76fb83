"""Work on one model or part, in workers: decompose, slice, move cuts; and the part rooms they use."""
