"""Reads mesh files into arrays, of avatars and garments alike; a faulty file raises a `ContentError`."""
