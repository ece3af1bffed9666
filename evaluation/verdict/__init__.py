"""What the estimates answer: items, rules, sentences, a level for a site."""
