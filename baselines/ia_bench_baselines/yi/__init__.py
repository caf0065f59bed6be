"""Yi et al. 2023: albedo, normals and light of one picture, learned from one object under several lights by low rank."""
