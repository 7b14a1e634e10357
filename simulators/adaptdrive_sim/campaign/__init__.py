"""Campaigns: thousands of randomised runs of the motor, fixed and adaptive side by side."""
