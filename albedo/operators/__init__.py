"""Operators make models from models; what they need of a model they compute with its bound."""
