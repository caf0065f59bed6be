"""Pictures of the page, drawn from what runs have recovered and packed into files that load when they are asked for."""
