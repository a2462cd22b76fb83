"""Tasks of workers on one model or part: decompose, slice, move cuts; and the usable volumes of printers."""
