"""A client of a tada-server: `Phone` for apps and simulations, `Staff` for studies and their records."""

from tada_client.caller import Caller
from tada_client.errors import NetworkError, Problem
from tada_client.phone import Phone, Photograph
from tada_client.retries import RetryPolicy
from tada_client.staff import Staff

__all__ = ["Caller", "NetworkError", "Phone", "Photograph", "Problem", "RetryPolicy", "Staff"]
