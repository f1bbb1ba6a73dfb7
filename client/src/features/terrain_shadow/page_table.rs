//! The page table: finds the drawn chunk at a position, and the highest point there.
//!
//! Quadtrees whose roots are a grid of equal squares. A leaf is a drawn chunk, and every node has
//! the maximum height below it. The maximum pyramid of a chunk continues the tree below its leaf,
//! so that a ray skips empty land, chunks and blocks by one test. Coordinates count from the
//! north-west corner of the grid, a multiple of the side of a root.

use rustc_hash::{FxHashMap, FxHashSet};
use shaders::layout::{EMPTY_LINK, LEAF, MAX_ROOTS, NODES_PER_SLOT, PageNode, ShadowTarget};
use terrain::ChunkKey;
use terrain::constants::{CELLS, SPACING_BITS, TOP_LEVEL};

/// A drawn chunk, as a shadow caster.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Page {
    /// The chunk.
    pub key: ChunkKey,
    /// Its slot in the pool.
    pub slot: u32,
    /// Its highest vertex, units.
    pub max_height: i32,
}

/// The page table of a set of drawn chunks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PageTable {
    /// Roots row by row, then their descendants, four by four.
    pub nodes: Vec<PageNode>,
    /// Number of roots from west to east.
    pub columns: u32,
    /// Number of roots from north to south.
    pub rows: u32,
    /// log2 of the side of a root, steps of 2 m.
    pub root_bits: u32,
    /// Low corner, units.
    origin: (i32, i32),
}

const EMPTY: PageNode = PageNode { link: EMPTY_LINK, max_height: i32::MIN };

impl PageTable {
    /// The table of chunks of which none is an ancestor of another.
    ///
    /// Capacity: [`MAX_ROOTS`] and [`NODES_PER_SLOT`] nodes for each of `slots`. A balanced cover
    /// of a view never exceeds it; fine chunks beyond it cast no shadow.
    #[must_use]
    pub fn of(pages: &[Page], slots: u32) -> Self {
        let Some(coarsest) = pages.iter().map(|page| page.key.level()).max() else { return Self::default() };
        let roots = (coarsest..=TOP_LEVEL).map(|level| Roots::of(pages, level));
        // Level 15 has four chunks and level 16 one, so the search ends.
        let Some(roots) = roots.into_iter().find(|roots| roots.count() <= MAX_ROOTS) else {
            return Self::default();
        };

        let leaves: FxHashMap<ChunkKey, &Page> = pages.iter().map(|page| (page.key, page)).collect();
        let above = |page: &Page| std::iter::successors(page.key.parent(), |key| key.parent());
        let split: FxHashSet<ChunkKey> = pages.iter().flat_map(above).collect();
        let capacity = MAX_ROOTS + NODES_PER_SLOT * slots as usize;

        let mut keys: Vec<Option<ChunkKey>> = roots.keys().collect();
        let mut nodes = Vec::with_capacity(2 * pages.len());
        while let Some(key) = keys.get(nodes.len()) {
            let leaf = key.and_then(|key| leaves.get(&key));
            let children = key.filter(|key| split.contains(key)).and_then(ChunkKey::children);
            nodes.push(match (leaf, children) {
                (Some(page), _) => PageNode { link: LEAF | page.slot, max_height: page.max_height },
                (None, Some(children)) if keys.len() + children.len() <= capacity => {
                    let link = keys.len() as u32;
                    keys.extend(children.map(Some));
                    PageNode { link, max_height: i32::MIN }
                }
                _ => EMPTY,
            });
        }
        // Children come after their parents.
        for index in (0..nodes.len()).rev() {
            let first = nodes[index].link as usize;
            if nodes[index].link < EMPTY_LINK {
                nodes[index].max_height =
                    nodes[first..first + 4].iter().map(|child| child.max_height).max().unwrap_or(i32::MIN);
            }
        }
        Self {
            nodes,
            columns: roots.columns,
            rows: roots.rows,
            root_bits: CELLS.trailing_zeros() + u32::from(roots.level),
            origin: roots.low.origin(),
        }
    }

    /// The highest point, units.
    #[must_use]
    pub fn max_height(&self) -> i32 {
        let roots = (self.columns * self.rows) as usize;
        self.nodes[..roots].iter().map(|node| node.max_height).max().unwrap_or(i32::MIN)
    }

    /// Shader parameters of a chunk of the table.
    #[must_use]
    pub fn target(&self, page: &Page) -> ShadowTarget {
        let (x, z) = page.key.origin();
        // A world is 2^22 steps wide.
        let steps = |at: i32, low: i32| ((i64::from(at) - i64::from(low)) >> SPACING_BITS) as i32;
        ShadowTarget {
            x: steps(x, self.origin.0),
            z: steps(z, self.origin.1),
            slot: page.slot,
            level: u32::from(page.key.level()),
        }
    }
}

/// The smallest rectangle of chunks of one level that covers some pages.
struct Roots {
    level: u8,
    low: ChunkKey,
    columns: u32,
    rows: u32,
}

impl Roots {
    /// `pages` holds at least one page, and none coarser than `level`.
    fn of(pages: &[Page], level: u8) -> Self {
        let ancestor = |page: &Page| {
            let (x, z) = page.key.origin();
            ChunkKey::containing(level, x, z)
        };
        let first = ancestor(&pages[0]);
        let corners = ((first.x(), first.z()), (first.x(), first.z()));
        let (low, high) = pages.iter().map(ancestor).fold(corners, |(low, high), key| {
            ((low.0.min(key.x()), low.1.min(key.z())), (high.0.max(key.x()), high.1.max(key.z())))
        });
        Self {
            level,
            low: ChunkKey::new(level, low.0, low.1).unwrap_or(first),
            columns: high.0.abs_diff(low.0) + 1,
            rows: high.1.abs_diff(low.1) + 1,
        }
    }

    fn count(&self) -> usize {
        self.columns as usize * self.rows as usize
    }

    /// Row by row.
    fn keys(&self) -> impl Iterator<Item = Option<ChunkKey>> + '_ {
        let (columns, rows) = (self.columns as i32, self.rows as i32);
        (0..rows).flat_map(move |row| (0..columns).map(move |column| self.low.neighbour(column, row)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use terrain::constants::WORLD_HALF;

    fn page(level: u8, x: i32, z: i32, slot: u32) -> Page {
        Page { key: ChunkKey::new(level, x, z).unwrap(), slot, max_height: slot as i32 * 100 }
    }

    /// The slot that is drawn at a place by the table, as the shader descends.
    fn found(table: &PageTable, x: i32, z: i32) -> Option<u32> {
        let step = |at: i32, low: i32| (i64::from(at) - i64::from(low)) >> SPACING_BITS;
        let cell = (step(x, table.origin.0), step(z, table.origin.1));
        let side = 1i64 << table.root_bits;
        let inside = |at: i64, count: u32| (0..i64::from(count) * side).contains(&at);
        if !inside(cell.0, table.columns) || !inside(cell.1, table.rows) {
            return None;
        }
        let mut bits = table.root_bits;
        let mut node = table.nodes[((cell.1 >> bits) * i64::from(table.columns) + (cell.0 >> bits)) as usize];
        while node.link < EMPTY_LINK {
            bits -= 1;
            let quarter = ((cell.0 >> bits) & 1) + 2 * ((cell.1 >> bits) & 1);
            let child = table.nodes[node.link as usize + quarter as usize];
            assert!(child.max_height <= node.max_height, "a node below the highest point under it");
            node = child;
        }
        (node.link != EMPTY_LINK).then_some(node.link & !LEAF)
    }

    #[test]
    fn an_empty_table_says_nothing() {
        let table = PageTable::of(&[], 10);
        assert_eq!((found(&table, 0, 0), table.max_height()), (None, i32::MIN));
    }

    #[test]
    fn pages_on_both_sides_of_the_origin_are_found_and_gaps_are_gaps() {
        let pages = [page(1, -1, -1, 7), page(0, 0, 0, 8), page(0, 1, 1, 9), page(2, 1, 0, 3)];
        let table = PageTable::of(&pages, 10);
        let chunk = 1 << 15;
        for ((x, z), slot) in [
            ((-1, -1), Some(7)),
            ((-2 * chunk, -2 * chunk), Some(7)),
            ((-2 * chunk - 1, -1), None),
            ((0, 0), Some(8)),
            ((chunk, 0), None),
            ((chunk, chunk), Some(9)),
            ((4 * chunk, 3), Some(3)),
            ((8 * chunk, 3), None),
        ] {
            assert_eq!(found(&table, x, z), slot, "({x}, {z})");
        }
        assert_eq!(table.max_height(), 900);
        let far = table.target(&pages[3]);
        assert_eq!(
            (far.x, far.z, far.level),
            (8 * 64, 4 * 64, 2),
            "counted from two roots of level 2 further west and north"
        );
    }

    #[test]
    fn chunks_in_opposite_corners_of_the_world_share_a_table() {
        let last = 32_767;
        let pages = [page(0, -32_768, -32_768, 1), page(0, last, last, 2), page(0, -32_768, last, 3)];
        // Three chains of 15 levels.
        let table = PageTable::of(&pages, 30);
        assert!(table.columns * table.rows <= MAX_ROOTS as u32);
        let edge = WORLD_HALF - 1;
        assert_eq!(found(&table, -WORLD_HALF, -WORLD_HALF), Some(1));
        assert_eq!(found(&table, edge, edge), Some(2));
        assert_eq!(found(&table, -WORLD_HALF, edge), Some(3));
        assert_eq!(found(&table, 0, 0), None);
        let target = table.target(&pages[1]);
        assert_eq!((target.x, target.z), ((1 << 22) - 64, (1 << 22) - 64));
    }

    #[test]
    fn the_root_of_the_world_is_a_page_like_any_other() {
        let table = PageTable::of(&[page(TOP_LEVEL, 0, 0, 5)], 1);
        assert_eq!(found(&table, -WORLD_HALF, WORLD_HALF - 1), Some(5));
    }

    #[test]
    fn the_room_is_never_exceeded() {
        // Scattered so widely that each needs a branch of its own.
        let pages: Vec<Page> =
            (0..200).map(|n| page(0, n * 301 - 30_000, (n * 7_919) % 30_000, n as u32)).collect();
        let table = PageTable::of(&pages, 20);
        assert!(table.nodes.len() <= MAX_ROOTS + NODES_PER_SLOT * 20);
        let whole = PageTable::of(&pages, 2000);
        for page in &pages {
            let (x, z) = page.key.origin();
            assert_eq!(found(&whole, x, z), Some(page.slot));
        }
    }

    proptest! {
        #[test]
        fn a_table_does_not_depend_on_where_in_the_world_it_is(
            places in proptest::collection::btree_set((-40i32..40, -40i32..40), 1..60),
            shift in (-7i32..7, -7i32..7),
        ) {
            let pages = |(east, south): (i32, i32)| {
                let places = places.iter().enumerate();
                places
                    .map(|(n, (x, z))| page(0, x + (east << 12), z + (south << 12), n as u32))
                    .collect::<Vec<_>>()
            };
            let (home, far) = (PageTable::of(&pages((0, 0)), 100), PageTable::of(&pages(shift), 100));
            prop_assert_eq!(PageTable { origin: home.origin, ..far }, home);
        }
    }
}
