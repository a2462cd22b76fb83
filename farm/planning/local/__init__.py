"""Planning of one model without a daemon: `farm decompose` and `farm slice`."""
