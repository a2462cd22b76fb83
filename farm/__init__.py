"""farm: a fleet of 3D printers (Ultimaker 2+ and others) used as one fast printer for large models."""

__version__: str


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module 'farm' has no attribute {name!r}")
    from importlib.metadata import version  # slow to load, and rarely needed

    return version("farm")
