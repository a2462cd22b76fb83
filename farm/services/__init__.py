"""model -> plan -> plates: the one place where decompose, slicing and drivers are combined."""
