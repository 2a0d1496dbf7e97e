//! The tables of a crate file, as they are written.

use std::collections::HashMap;
use std::hash::Hash;

use super::ValueRep;
use super::integers::{compressed, compressed_integers};

/// Ends a set of fields.
pub(super) const END_OF_SET: u32 = u32::MAX;
/// Steps from a path to the next one: to its child, nothing more, or its sibling. A path with both
/// has the distance of its sibling, and its child behind it.
const CHILD_ONLY: u32 = -1i32 as u32;
const NOTHING: u32 = -2i32 as u32;
const SIBLING: u32 = 0;

/// Items by number, each once.
pub(super) struct Table<T> {
    pub(super) items: Vec<T>,
    numbers: HashMap<T, u32>,
}

impl<T: Clone + Eq + Hash> Table<T> {
    pub(super) fn new() -> Self {
        Self { items: Vec::new(), numbers: HashMap::new() }
    }

    pub(super) fn number(&mut self, item: T) -> u32 {
        let next = self.items.len() as u32;
        *self.numbers.entry(item.clone()).or_insert_with(|| {
            self.items.push(item);
            next
        })
    }
}

/// An entry of the table of fields: the number of its name, and its value.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Field {
    pub(super) name: u32,
    pub(super) value: ValueRep,
}

/// A spec: a path's kind and fields.
pub(super) struct Spec {
    pub(super) fields_at: u32,
    pub(super) kind: u32,
}

/// A prim or a property, in the order of their specs: each prim, its properties, then the prims
/// within it.
pub(super) struct Node {
    pub(super) name: String,
    /// Number of prims around it.
    pub(super) depth: usize,
    pub(super) is_property: bool,
}

pub(super) fn counted(count: usize, bytes: impl Iterator<Item = u8>) -> Vec<u8> {
    (count as u64).to_le_bytes().into_iter().chain(bytes).collect()
}

/// Returns bytes behind their length.
fn sized(bytes: Vec<u8>) -> Vec<u8> {
    counted(bytes.len(), bytes.into_iter())
}

pub(super) fn tokens_table(tokens: &[String]) -> Vec<u8> {
    let plain: Vec<u8> = tokens.iter().flat_map(|token| token.bytes().chain([0])).collect();
    let mut table = counted(tokens.len(), (plain.len() as u64).to_le_bytes().into_iter());
    table.extend(sized(compressed(&plain)));
    table
}

pub(super) fn integers_table(count: usize, columns: &[&[u32]]) -> Vec<u8> {
    counted(count, columns.iter().flat_map(|column| sized(compressed_integers(column))))
}

pub(super) fn fields_table(fields: &[Field]) -> Vec<u8> {
    let names: Vec<u32> = fields.iter().map(|field| field.name).collect();
    let values: Vec<u8> = fields.iter().flat_map(|field| field.value.0.to_le_bytes()).collect();
    let mut table = integers_table(fields.len(), &[&names]);
    table.extend(sized(compressed(&values)));
    table
}

pub(super) fn specs_table(specs: &[Spec]) -> Vec<u8> {
    let paths: Vec<u32> = (0..specs.len() as u32).collect();
    let fields: Vec<u32> = specs.iter().map(|spec| spec.fields_at).collect();
    let kinds: Vec<u32> = specs.iter().map(|spec| spec.kind).collect();
    integers_table(specs.len(), &[&paths, &fields, &kinds])
}

/// Returns the table of paths: the root, then prims and properties, each with the step to what
/// follows it.
pub(super) fn paths_table(nodes: &[Node], tokens: &mut Table<String>) -> Vec<u8> {
    let count = 1 + nodes.len();
    let numbers: Vec<u32> = (0..count as u32).collect();
    let (mut elements, mut steps) = (vec![0], vec![if nodes.is_empty() { NOTHING } else { CHILD_ONLY }]);
    for (i, node) in nodes.iter().enumerate() {
        let token = tokens.number(node.name.clone());
        elements.push(if node.is_property { token.wrapping_neg() } else { token });
        let behind = &nodes[i + 1..];
        let has_child = behind.first().is_some_and(|next| next.depth > node.depth);
        // The first that is not within it, unless it is outside of what is around both.
        let sibling = behind.iter().position(|next| next.depth <= node.depth).filter(|at| behind[*at].depth == node.depth);
        steps.push(match (has_child, sibling) {
            (true, Some(at)) => at as u32 + 1,
            (true, None) => CHILD_ONLY,
            (false, Some(_)) => SIBLING,
            (false, None) => NOTHING,
        });
    }
    let mut table = (count as u64).to_le_bytes().to_vec();
    table.extend(integers_table(count, &[&numbers, &elements, &steps]));
    table
}
