"""How far the pipeline for own shapes can be trusted, on collections with one vertex order: see ``__main__``."""
