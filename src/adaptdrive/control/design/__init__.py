"""Design: from a model of the load to the gains of the controller."""
