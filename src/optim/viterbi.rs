//! The cheapest path through a few states per step.

/// The state of every step on the path of least cost. Steps without states are skipped: their entry is `None`.
///
/// $\min_{s} \sum_t u_t(s_t) + \sum_t d(s_{t-1}, s_t)$ over the steps that have states — Viterbi 1967.
///
/// `own[t][s]`: cost of a state; `change(t, r, u, s)`: cost of going from state `r` of step `t` to state `s` of step `u`.
/// Of equally cheap paths, the one through states of lower index.
pub fn cheapest_path(own: &[Vec<f64>], change: impl Fn(usize, usize, usize, usize) -> f64) -> Vec<Option<usize>> {
    let steps: Vec<usize> = (0..own.len()).filter(|&t| !own[t].is_empty()).collect();
    let mut path = vec![None; own.len()];
    let Some(&first) = steps.first() else { return path };
    let mut costs = own[first].clone();
    let mut came_from: Vec<Vec<usize>> = Vec::with_capacity(steps.len());
    for pair in steps.windows(2) {
        let (t, u) = (pair[0], pair[1]);
        let arrival = |s: usize| {
            let over = |r: usize| costs[r] + change(t, r, u, s);
            let best =
                (0..costs.len()).map(|r| (over(r), r)).fold((f64::INFINITY, 0), |a, b| if b.0 < a.0 { b } else { a });
            (best.0 + own[u][s], best.1)
        };
        let (next, from) = (0..own[u].len()).map(arrival).unzip();
        costs = next;
        came_from.push(from);
    }
    let mut state = (0..costs.len()).fold(0, |a, b| if costs[b] < costs[a] { b } else { a });
    for (i, &t) in steps.iter().enumerate().rev() {
        path[t] = Some(state);
        if i > 0 {
            state = came_from[i - 1][state];
        }
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn follows_lasting_changes_and_not_single_outliers() {
        let costs_of = |state: usize| if state == 0 { vec![0.0, 1.0] } else { vec![1.0, 0.0] };
        let step = |_: usize, r: usize, _: usize, s: usize| if r == s { 0.0 } else { 1.5 };
        let path = |seen: &[usize]| cheapest_path(&seen.iter().map(|&s| costs_of(s)).collect::<Vec<_>>(), step);
        assert_eq!(path(&[0, 0, 0, 1, 0, 0, 0]), [Some(0); 7]);
        assert_eq!(path(&[0, 0, 0, 1, 1, 1, 1])[2..4], [Some(0), Some(1)]);
    }

    #[test]
    fn steps_without_states_are_passed_over() {
        let own = [vec![], vec![0.0, 5.0], vec![], vec![5.0, 4.0], vec![]];
        let path = cheapest_path(&own, |t, r, u, s| {
            assert_eq!((t, u), (1, 3));
            if r == s { 0.0 } else { 9.0 }
        });
        assert_eq!(path, [None, Some(0), None, Some(0), None]);
        assert_eq!(cheapest_path(&[vec![], vec![]], |_, _, _, _| 0.0), [None, None]);
    }
}
