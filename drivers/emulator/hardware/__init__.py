"""What an emulated printer has physically: heaters, a bed, a wire and its noise."""
