"""The species library: what is known of a species, its branchlets and patches, its pictures."""
