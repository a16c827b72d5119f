"""The certificate of a site: measuring at taped distances, and the page that says what came of it."""
