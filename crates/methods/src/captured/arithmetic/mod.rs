//! Arithmetic that networks and losses of several methods share: functions over arrays, numbers in
//! blocks of sixteen, second colours of splats as tables, and Adam.

pub(super) mod adam;
pub(super) mod blocks;
pub(super) mod color_map;
pub(super) mod elementwise;
