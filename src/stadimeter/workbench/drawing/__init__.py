"""Drawings as files at true scale: PDF and SVG."""
