"""What a person sees: terminal, LaTeX, page."""
