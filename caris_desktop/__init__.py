"""CARIS Desktop: an operator console for Wizard-of-Oz studies with mobile robots."""

__version__ = "0.1.0"
