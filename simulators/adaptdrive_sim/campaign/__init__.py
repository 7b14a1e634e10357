"""Campaigns: thousands of randomised runs of a motor or a bath, fixed and adaptive side by side."""
