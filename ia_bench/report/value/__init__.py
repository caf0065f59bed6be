"""What a prior is worth: by how much it beats the same fit without it, for every way in which a scene is photographed."""
