"""Hardware of an emulated printer: heaters, a bed, a wire and its noise."""
