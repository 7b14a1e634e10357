"""Batch identification of a load from records, for commissioning and analysis."""
