"""Policy for all arms, trained over random arms and tried on arms that its training has not drawn."""
