"""tada-server: photographs of a meal in, food volumes and nutrient records out."""

__version__ = "0.4.0"
