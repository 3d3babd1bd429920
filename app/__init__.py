"""tada-server: photographs of a meal in, food volumes and nutrient records out."""

__version__ = "0.5.0.dev0"
