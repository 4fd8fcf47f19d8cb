"""gsb-episodes: success and return of a policy over as many episodes of each environment, alone or against another."""
