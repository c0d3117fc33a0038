"""Bags that other programs recorded, made into sessions."""
