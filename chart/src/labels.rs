//! Places of labels beside their dots.

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Bounds {
    pub low: (i32, i32),
    pub high: (i32, i32),
}

impl Bounds {
    /// Bounds of a dot.
    pub const fn around((x, y): (i32, i32)) -> Self {
        Self { low: (x - 7, y - 7), high: (x + 7, y + 7) }
    }

    const fn meets(&self, other: &Self) -> bool {
        self.low.0 < other.high.0
            && other.low.0 < self.high.0
            && self.low.1 < other.high.1
            && other.low.1 < self.high.1
    }

    const fn holds(&self, other: &Self) -> bool {
        self.low.0 <= other.low.0
            && other.high.0 <= self.high.0
            && self.low.1 <= other.low.1
            && other.high.1 <= self.high.1
    }
}

/// Upper left corner of a label beside its dot where it covers neither dots nor labels, and
/// reserves it. Lines may pass under it. In a crowd the first corner is taken.
pub(crate) fn free(
    (x, y): (i32, i32),
    (width, height): (i32, i32),
    frame: &Bounds,
    taken: &mut Vec<Bounds>,
) -> (i32, i32) {
    let (right, left, above, below) = (x + 12, x - 12 - width, y - 6 - height, y + 6);
    let beside = y - height / 2;
    let corners =
        [(right, above), (right, beside), (right, below), (left, below), (left, beside), (left, above)];
    let boxed = |corner: (i32, i32)| Bounds { low: corner, high: (corner.0 + width, corner.1 + height) };
    let is_free = |name: &Bounds| frame.holds(name) && !taken.iter().any(|other| other.meets(name));
    let corner = corners.into_iter().find(|corner| is_free(&boxed(*corner))).unwrap_or(corners[0]);
    taken.push(boxed(corner));
    corner
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_cover_neither_dots_nor_each_other() {
        let frame = Bounds { low: (0, 0), high: (300, 300) };
        let anchors = [(150, 150), (152, 160), (290, 8), (150, 120)];
        let mut taken = anchors.map(Bounds::around).to_vec();
        let size = (60, 16);
        for anchor in anchors {
            let corner = free(anchor, size, &frame, &mut taken);
            let name = Bounds { low: corner, high: (corner.0 + size.0, corner.1 + size.1) };
            assert!(frame.holds(&name), "{anchor:?} {name:?}");
            let (_, others) = taken.split_last().unwrap();
            assert!(!others.iter().any(|other| other.meets(&name)), "{anchor:?} {name:?}");
        }
        assert!(Bounds::around((5, 5)).meets(&Bounds::around((10, 10))), "the control");
    }
}
