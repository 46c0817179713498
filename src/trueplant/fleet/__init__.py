"""Many loops: a site and its loops, their audit one by one or on several processes, what came out, ranked."""

from trueplant.fleet.audit import Audited, Options, audit
from trueplant.fleet.site import Site

__all__ = ["Audited", "Options", "Site", "audit"]
