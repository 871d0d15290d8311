"""Arms and legs moved out of the trunk and of each other, by joint positions changed as little as that takes."""
