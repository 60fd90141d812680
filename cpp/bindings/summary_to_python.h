#pragma once

#include <pybind11/pybind11.h>

#include <vector>

#include "core/interface/summary.h"

/// Converts to a dict with the names of the C++ fields.
pybind11::dict ToDict(const bundle::SolveSummary& summary);
pybind11::dict ToDict(const bundle::IterationRecord& record);

/// One array a field, one entry an iteration.
pybind11::dict ToArrays(const std::vector<bundle::IterationRecord>& records);

/// Adds what python/bundle/interface/solve_record.py takes out.
void PutRecord(const bundle::SolveRecord& record, pybind11::dict* result);

/// The reverse of ToArrays. Takes sequences as long as each other; throws InputError for others.
std::vector<bundle::IterationRecord> RecordsFromPython(const pybind11::dict& iterations);
