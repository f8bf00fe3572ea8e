//! Minimum-cost assignment of rows to columns.

/// Assigns rows to columns at the least total cost; pairs that cost `forbidden` or more stay unassigned. `cost(row, column)` must be
/// finite.
///
/// Returns the column of each row; `None` for unassigned rows.
pub fn assign(
    n_rows: usize,
    n_columns: usize,
    forbidden: f64,
    cost: impl Fn(usize, usize) -> f64,
) -> Vec<Option<usize>> {
    let costs: Vec<Vec<f64>> =
        (0..n_rows).map(|row| (0..n_columns).map(|column| cost(row, column)).collect()).collect();
    assign_by_table(&costs, forbidden)
}

/// [`assign`] by a table of all costs, `[row][column]`.
pub fn assign_by_table(costs: &[Vec<f64>], forbidden: f64) -> Vec<Option<usize>> {
    let (n_rows, n_columns) = (costs.len(), costs.first().map_or(0, Vec::len));
    let is_possible = |row: usize, column: usize| costs[row][column] < forbidden;
    // Most pairs show two people who are far from each other: rows and columns without a possible pair would only lengthen every path.
    let rows: Vec<usize> = (0..n_rows).filter(|&row| (0..n_columns).any(|column| is_possible(row, column))).collect();
    let columns: Vec<usize> =
        (0..n_columns).filter(|&column| rows.iter().any(|&row| is_possible(row, column))).collect();
    let cost = |i: usize, j: usize| costs[rows[i]][columns[j]];
    let pairs = if rows.len() <= columns.len() {
        cheapest_pairs(rows.len(), columns.len(), forbidden, cost)
    } else {
        let turned = cheapest_pairs(columns.len(), rows.len(), forbidden, |j, i| cost(i, j));
        turned.into_iter().map(|(j, i)| (i, j)).collect()
    };
    let mut column_of = vec![None; n_rows];
    pairs.into_iter().for_each(|(i, j)| column_of[rows[i]] = Some(columns[j]));
    column_of
}

/// Rows with their columns at the least total cost, each row without one costing `forbidden`.
///
/// Shortest augmenting paths with potentials (Jonker and Volgenant 1987), O(n^2 (n + m)) for n rows and m columns.
fn cheapest_pairs(
    n_rows: usize,
    n_columns: usize,
    forbidden: f64,
    cost: impl Fn(usize, usize) -> f64,
) -> Vec<(usize, usize)> {
    // Besides the columns there is a dummy for each row at cost `forbidden`: the problem is always feasible.
    let (n, m) = (n_rows, n_columns + n_rows);
    let entry = |i: usize, j: usize| if j < n_columns { cost(i, j).min(forbidden) } else { forbidden };
    let (mut u, mut v) = (vec![0.0; n + 1], vec![0.0; m + 1]);
    let mut row_of = vec![0usize; m + 1]; // 1-based; 0 is "none"
    let mut columns = vec![Column::default(); m + 1];
    for i in 1..=n {
        augment(i, &mut columns, &entry, &mut u, &mut v, &mut row_of);
    }
    let matched = (1..=n_columns).filter(|&j| row_of[j] > 0).map(|j| (row_of[j] - 1, j - 1));
    matched.filter(|&(row, column)| cost(row, column) < forbidden).collect()
}

/// A column in the search of a path.
#[derive(Debug, Clone, Copy, Default)]
struct Column {
    slack: f64,
    came_from: usize,
    is_done: bool,
}

/// Adds row `start` (1-based) to the matching along the cheapest alternating path; `columns`: scratch, that of the start first.
fn augment(
    start: usize,
    columns: &mut [Column],
    entry: &impl Fn(usize, usize) -> f64,
    u: &mut [f64],
    v: &mut [f64],
    row_of: &mut [usize],
) {
    row_of[0] = start;
    let mut column = 0;
    columns.fill(Column { slack: f64::INFINITY, ..Column::default() });
    while row_of[column] != 0 {
        columns[column].is_done = true;
        let row = row_of[column];
        let (mut delta, mut next) = (f64::INFINITY, 0);
        for (j, found) in columns.iter_mut().enumerate().skip(1).filter(|(_, found)| !found.is_done) {
            let reduced = entry(row - 1, j - 1) - u[row] - v[j];
            if reduced < found.slack {
                (found.slack, found.came_from) = (reduced, column);
            }
            if found.slack < delta {
                (delta, next) = (found.slack, j);
            }
        }
        for (j, found) in columns.iter_mut().enumerate() {
            if found.is_done {
                u[row_of[j]] += delta;
                v[j] -= delta;
            } else {
                found.slack -= delta;
            }
        }
        column = next;
    }
    while column != 0 {
        let previous = columns[column].came_from;
        row_of[column] = row_of[previous];
        column = previous;
    }
}

/// Least cost of another pair in the row or the column of a pair.
pub fn rival(costs: &[Vec<f64>], row: usize, column: usize) -> f64 {
    let in_row = (0..costs[row].len()).filter(|&c| c != column).map(|c| costs[row][c]);
    let in_column = (0..costs.len()).filter(|&r| r != row).map(|r| costs[r][column]);
    in_row.chain(in_column).fold(f64::INFINITY, f64::min)
}

/// Pairs below `reach` that cost less than `uniqueness` times any rival, the first of each row, among those that are `possible`.
pub fn lone_pairs(
    costs: &[Vec<f64>],
    reach: f64,
    uniqueness: f64,
    possible: impl Fn(usize, usize) -> bool,
) -> Vec<(usize, usize)> {
    let is_lone = |row: usize, column: usize| {
        let cost = costs[row][column];
        possible(row, column) && cost < reach && cost < uniqueness * rival(costs, row, column)
    };
    let of_row = |row: usize| (0..costs[row].len()).find(|&column| is_lone(row, column)).map(|column| (row, column));
    (0..costs.len()).filter_map(of_row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn best_by_enumeration(costs: &[Vec<f64>], row: usize, used: &mut Vec<bool>, forbidden: f64) -> f64 {
        if row == costs.len() {
            return 0.0;
        }
        let mut best = forbidden + best_by_enumeration(costs, row + 1, used, forbidden);
        for j in 0..costs[row].len() {
            if !used[j] && costs[row][j] < forbidden {
                used[j] = true;
                best = best.min(costs[row][j] + best_by_enumeration(costs, row + 1, used, forbidden));
                used[j] = false;
            }
        }
        best
    }

    #[test]
    fn equals_enumeration_on_seeded_matrices() {
        let mut state = 1u64;
        let mut uniform = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) as f64 / (1u64 << 31) as f64
        };
        for trial in 0..300 {
            let (n, m) = (1 + trial % 5, 1 + (trial / 5) % 6);
            let costs: Vec<Vec<f64>> = (0..n).map(|_| (0..m).map(|_| uniform()).collect()).collect();
            let columns = assign(n, m, 0.7, |i, j| costs[i][j]);
            let total: f64 = columns.iter().enumerate().map(|(i, c)| c.map_or(0.7, |j| costs[i][j])).sum();
            let best = best_by_enumeration(&costs, 0, &mut vec![false; m], 0.7);
            assert!((total - best).abs() < 1e-12, "{n}x{m}: {total} against {best}");
        }
    }

    /// A fifth of the solve of 16 people: every detection was searched on every path from every tracklet, however far from it.
    #[test]
    fn each_pair_is_judged_once() {
        let n_judged = std::cell::Cell::new(0);
        let cost = |i: usize, j: usize| {
            n_judged.set(n_judged.get() + 1);
            if i == j { 0.1 } else { 2.0 }
        };
        let columns = assign(200, 16, 1.0, cost);
        assert_eq!(columns, (0..200).map(|i| (i < 16).then_some(i)).collect::<Vec<_>>());
        assert_eq!(n_judged.get(), 200 * 16);
    }
}
