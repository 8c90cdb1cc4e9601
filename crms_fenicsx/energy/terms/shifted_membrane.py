"""TEMPORARY stand-in until the real kernel arrives."""
import sys; sys.path.insert(0, "/work/shared/prototype/lines")
from dataclasses import dataclass
import numpy as np
from crms_fenicsx.energy.terms.term import ElementTerm
from crms_fenicsx.foundation.dofs.block_patterns import ElementPattern
from crms_fenicsx.foundation.dofs.layout import ElementTable
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from kernel import cells as kernel
@dataclass(frozen=True)
class ShiftedCells(ElementTable):
    cells: object
    corners: object
    shifts: object
    X: object
    Et: float
    nu: float
    addresses = ("corners", "shifts")
    @classmethod
    def of(cls, membrane, cells, corners, shifts):
        mesh = membrane.u.function_space.mesh
        m = next(iter(membrane.materials.values()))
        # corners given in the cells' own order of the strip
        return cls(cells, corners.astype(np.int32), shifts.astype(np.int32), None, m.reference_modulus, m.nu)
    @property
    def element_blocks(self):
        both = np.concatenate([self.corners, self.shifts], axis=1)
        keep = both >= 0
        return np.append(0, np.cumsum(keep.sum(axis=1))).astype(np.int32), both[keep].astype(np.int32)
class ShiftedMembraneEnergy(ElementTerm):
    name = "membrane"; exact_hessian = True; of_cables = True
    def __init__(self, table, stiffening):
        super().__init__(table); self.stiffening = stiffening
        n = len(table.cells); self.e, self.g, self.H = np.zeros(1), np.zeros((n, 18)), np.zeros((n, 18, 18))
        self.elements = ElementPattern(*table.element_blocks); self.patterns = (self.elements,)
        both = np.concatenate([table.corners, table.shifts], axis=1); self.keep = both >= 0; self.both = both
        self.k2 = (self.keep[:, :, None] & self.keep[:, None, :])
    def places(self, x):
        t, X = self.table, self.unknowns.X; m = len(t.cells)
        Xc = X[t.corners]; w = np.where((t.shifts >= 0)[..., None], x[t.shifts], 0.0)
        self.px = np.ascontiguousarray((Xc + x[t.corners]).reshape(-1, 3)); self.pX = np.ascontiguousarray((Xc + w).reshape(-1, 3))
        self.T = np.arange(3 * m).reshape(-1, 3)
    def run(self, x, order): self.places(x); t = self.table; kernel(self.px, self.pX, self.T, t.Et, t.nu, True, order, self.e, self.g, self.H)
    def sums(self, x, out): self.run(x, 1); out[0] = self.e[0]
    def add_gradient(self, x, sums, g):
        f = self.g.reshape(-1, 6, 3); np.add.at(g, self.both[self.keep], f[self.keep])
    def add_hessian(self, x, sums, A):
        self.run(x, 2); K = self.H.reshape(-1, 6, 3, 6, 3).transpose(0, 1, 3, 2, 4); self.elements.values[:] = K[self.k2]; self.elements.add(A)
    def add_stiffness(self, x, sums, A):
        self.run(x, 2); w, V = np.linalg.eigh(self.H); H = np.einsum("nik,nk,njk->nij", V, np.maximum(w, 1e-6 * w[:, -1:]), V)
        K = H.reshape(-1, 6, 3, 6, 3).transpose(0, 1, 3, 2, 4); self.elements.values[:] = K[self.k2]; self.elements.add(A)
