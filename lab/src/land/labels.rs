//! Connected regions of a mask.

/// Regions of a mask: true and false ones.
pub struct Labels {
    /// The region of every point.
    pub of: Vec<u32>,
    /// All regions, true and false ones.
    pub regions: Vec<Region>,
}

/// One region.
#[derive(Clone, Debug, Default)]
pub struct Region {
    /// Whether the mask is true in it.
    pub is_set: bool,
    /// Points in it.
    pub points: u64,
    /// Whether it has a point on the edge of the mask.
    pub touches_edge: bool,
    sum: [u64; 2],
}

impl Region {
    /// Mean column and row.
    pub fn centroid(&self) -> [f64; 2] {
        self.sum.map(|sum| sum as f64 / self.points as f64)
    }
}

/// Labels the regions of a mask of rows of `columns` points.
///
/// Points of the same value are joined with their four neighbours; points whose value is
/// `diagonal` with all eight. So two regions never cross.
pub fn label(mask: &[bool], columns: usize, diagonal: bool) -> Labels {
    let mut of = vec![0u32; mask.len()];
    let mut parents: Vec<u32> = Vec::new();
    for start in (0..mask.len()).step_by(columns) {
        for column in 0..columns {
            let index = start + column;
            let joins_corners = mask[index] == diagonal;
            let earlier = [
                (column > 0, 1),
                (start > 0, columns),
                (joins_corners && start > 0 && column > 0, columns + 1),
                (joins_corners && start > 0 && column + 1 < columns, columns - 1),
            ];
            let mut own = None;
            for (_, back) in earlier.into_iter().filter(|(exists, _)| *exists) {
                if mask[index - back] != mask[index] {
                    continue;
                }
                let other = of[index - back];
                own = Some(match own {
                    Some(label) if label != other => join(&mut parents, label, other),
                    _ => other,
                });
            }
            of[index] = own.unwrap_or_else(|| {
                parents.push(parents.len() as u32);
                parents.len() as u32 - 1
            });
        }
    }
    gather(mask, columns, of, &mut parents)
}

/// Numbers the roots and sums up their points.
fn gather(mask: &[bool], columns: usize, mut of: Vec<u32>, parents: &mut [u32]) -> Labels {
    const NONE: u32 = u32::MAX;
    let mut numbers = vec![NONE; parents.len()];
    let mut regions: Vec<Region> = Vec::new();
    let last = mask.len() - columns;
    for start in (0..mask.len()).step_by(columns) {
        for column in 0..columns {
            let index = start + column;
            let provisional = of[index] as usize;
            if numbers[provisional] == NONE {
                let root = root(parents, of[index]) as usize;
                if numbers[root] == NONE {
                    numbers[root] = regions.len() as u32;
                    regions.push(Region { is_set: mask[index], ..Region::default() });
                }
                numbers[provisional] = numbers[root];
            }
            of[index] = numbers[provisional];
            let region = &mut regions[of[index] as usize];
            region.points += 1;
            region.touches_edge |= start == 0 || start == last || column == 0 || column + 1 == columns;
            region.sum[0] += column as u64;
            region.sum[1] += (start / columns) as u64;
        }
    }
    Labels { of, regions }
}

fn root(parents: &mut [u32], mut label: u32) -> u32 {
    while parents[label as usize] != label {
        parents[label as usize] = parents[parents[label as usize] as usize];
        label = parents[label as usize];
    }
    label
}

fn join(parents: &mut [u32], one: u32, other: u32) -> u32 {
    let (one, other) = (root(parents, one), root(parents, other));
    let (low, high) = (one.min(other), one.max(other));
    parents[high as usize] = low;
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(rows: &[&str], diagonal: bool) -> Labels {
        let mask: Vec<bool> = rows.iter().flat_map(|row| row.chars().map(|c| c == '#')).collect();
        label(&mask, rows[0].len(), diagonal)
    }

    fn points(labels: &Labels, is_set: bool) -> Vec<u64> {
        let mut points: Vec<u64> =
            labels.regions.iter().filter(|r| r.is_set == is_set).map(|r| r.points).collect();
        points.sort_unstable();
        points
    }

    #[test]
    fn diagonal_neighbours_join_one_of_the_two_values_only() {
        let rows = ["#..", ".#.", "..#"];
        assert_eq!((points(&of(&rows, true), true), points(&of(&rows, true), false)), (vec![3], vec![3, 3]));
        assert_eq!(
            (points(&of(&rows, false), true), points(&of(&rows, false), false)),
            (vec![1, 1, 1], vec![6])
        );
    }

    #[test]
    fn branches_that_meet_late_are_one_region_with_one_centroid() {
        let rows = [".......", ".#.#.#.", ".#####.", "......."];
        let labels = of(&rows, false);
        assert_eq!((points(&labels, true), points(&labels, false)), (vec![8], vec![20]));
        let island = labels.regions.iter().find(|region| region.is_set).unwrap();
        assert!(!island.touches_edge && island.centroid()[0] == 3.0);
        assert!(labels.regions.iter().any(|region| !region.is_set && region.touches_edge));
    }

    #[test]
    fn a_lake_does_not_touch_the_edge() {
        let labels = of(&[".....", ".###.", ".#.#.", ".###.", "....."], false);
        let lakes = labels.regions.iter().filter(|region| !region.is_set && !region.touches_edge);
        assert_eq!(lakes.count(), 1);
    }
}
