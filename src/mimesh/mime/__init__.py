"""mime: a network reads joints and skinning weights, the shipped body is fitted to each surface, parts are tracked."""
